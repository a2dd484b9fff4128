// A payload to its Gaussians: docs/format.md, "Payload" and "Integers to Gaussians".

import { newCoder } from "./coder.js";
import { floor, fround, max, min, refuseUnless } from "./header.js";
import { A, B, COLOUR_SIGNS, COUNT, DISTANCE, LUMA, R, SHAPE_SIGNS, V } from "./models.js";

const COLOUR = 0; // the states
const SHAPE = 1;
const NONE = [0, 0, 0];

/** Decode the Gaussians of a payload. onTurn(values, end) is called after each turn, with the Gaussian that it
 * completed (x, y, l1, l2, l3, red, green, blue) and the bytes read so far, or with nothing. onCost is newCoder()'s.
 * Throws SgError. */
export function readGaussians({ width, height, isShort, quantum, grey, upright }, payload, onTurn, onCost) {
  if (!payload.length) return;
  const [symbol, fetch, take, number, bytesRead, isEnded] = newCoder(payload, isShort, onCost);
  const whole = ([least, bits, , state, row]) => least + take(bits, state, row);
  const numberIf = (condition, state, row) => (condition ? number(state, row) : NONE);
  const isWhole = () => bytesRead() <= payload.length;
  const most = min(width * height, 2 ** 24, 8 * payload.length + 64);
  fetch(6);
  let k = 28 - take(6);
  fetch(6);
  const last = k - take(6);
  WHOLE: refuseUnless(isWhole() && last >= -4, "its classes are out of range");
  for (let total = 0; k >= last; k--) {
    const side = 2 ** max(0, (k + 1) >> 1);
    const [columns, rows] = [width, height].map((pixels) => min(floor(pixels / side) + 5, 65536));
    const count = number(COLOUR, COUNT);
    fetch(count[1]);
    const n = whole(count);
    total += n;
    refuseUnless(isWhole() && total <= most, "it has too many Gaussians");
    let t = 0;
    for (let mean = floor((columns * rows) / max(n, 1)); mean >= 8; mean /= 2) t++;
    t = min(t, 24);
    // A turn holds cell and colour of the next Gaussian, then shape and place of the one before it.
    let [cell, colour, square, h, uBits] = [0, [], 0, 0, 0]; // of the one before
    for (let i = 0; i <= n && n; i++) {
      const isMore = i < n;
      const bucket = min(h, 7);
      const distance = numberIf(isMore, COLOUR, DISTANCE);
      if (i) {
        const signs = symbol(SHAPE, COLOUR_SIGNS + 4 * (colour[0] > 0) + 2 * (colour[1] > 0) + (colour[2] > 0));
        colour = colour.map((value, c) => (signs & (4 >> c) ? -value : value));
      }
      const y = numberIf(isMore, COLOUR, LUMA);
      let v = numberIf(i, SHAPE, V + bucket);
      const a = numberIf(isMore && !grey, COLOUR, A + level(y[2]));
      let r = numberIf(i && !upright, SHAPE, R + bucket);
      const b = numberIf(isMore && !grey, COLOUR, B + level(a[2]));
      fetch(v[1] + r[1] + uBits + (isMore && t));
      [v, r] = [whole(v), whole(r)];
      const u = take(uBits, SHAPE, V);
      let parts = [0, 0];
      if (i) {
        WHOLE: refuseUnless(v <= 8 * 2 ** h && r <= 2048 * 2 ** h, "a shape is out of range");
        const signs = symbol(SHAPE, SHAPE_SIGNS + 2 * (v > 0) + (r > 0));
        if (signs & 2) v = -v;
        if (signs & 1) r = -r;
        parts = partBits(k, square, h, (u + 0.5) / 2 ** uBits, v, r);
      }
      const low = take(isMore && t, COLOUR, DISTANCE);
      fetch(y[1] + a[1] + b[1] + distance[1] + parts[0] + parts[1]);
      const next = [whole(y), whole(a), whole(b)];
      const far = whole(distance);
      if (i) {
        const within = parts.map((bits) => (take(bits, SHAPE, DISTANCE) + 0.5) / 2 ** bits);
        const place = within.map((part, axis) => (even(cell, axis) - 2 + part) * side);
        refuseUnless(isWhole(), "it ends too early");
        onTurn([...place, ...valuesOf(quantum, k, h, (u + 0.5) / 2 ** uBits, v, r, colour)].map(fround), bytesRead());
      }
      WHOLE: if (!i) onTurn();
      cell += far * 2 ** t + low;
      colour = next;
      if (isMore) {
        WHOLE: {
          const isWithin = cell < 2 ** 32 && even(cell, 0) < columns && even(cell, 1) < rows;
          refuseUnless(isWithin, "a place is out of range");
        }
        square = next[0] ** 2 + next[1] ** 2 + next[2] ** 2;
        WHOLE: refuseUnless(square, "a Gaussian has no colour");
        WHOLE: refuseUnless(max(...next) <= 2 ** 22, "a colour is out of range");
        h = min((log2(square) + 1) >> 1, 18);
        uBits = min(max(h - 1, 0), 12);
      }
    }
  }
  refuseUnless(isEnded(), "its end is wrong");
}

/** Which of a colour's models is next, by the symbol before. */
export const level = (symbol) => (symbol > 0) + (symbol > 2) + (symbol > 5);

/** The bits that a cell below 2^32 has for one axis: every other one. */
function even(cell, axis) {
  let n = 0;
  for (let rest = cell >>> axis, bit = 1; rest; rest >>>= 2, bit *= 2) n += rest & 1 && bit;
  return n;
}

/** The logarithm to base two of an integer, rounded down. Its digits are exact, Math.log2 is not. */
export const log2 = (x) => x.toString(2).length - 1;

/** The logarithm to base two in sixteenths, linear between powers of two. */
function lg(x) {
  const n = log2(x);
  return 16 * n + floor((16 * x) / 2 ** n) - 16;
}

/** lg(4^h + 4 r^2), also where that has more than 53 bits. */
function lgOfSquares(h, r) {
  const squares = 4 ** h + 4 * r * r;
  WHOLE: if (squares >= 2 ** 53) {
    const exact = 4n ** BigInt(h) + 4n * BigInt(r) ** 2n;
    const n = log2(exact);
    return 16 * n + Number((16n * exact) >> BigInt(n)) - 16;
  }
  return lg(squares);
}

/** How many bits divide the cell along x and along y. */
export function partBits(k, square, h, u, v, r) {
  const within = floor(16 * u) - 8;
  const aspect = floor((46 * v) / 2 ** h);
  const slant = lgOfSquares(h, r) - 32 * h;
  const fineness = lg(square) + 32 * max(0, (k + 1) >> 1) - 17;
  const along = fineness + slant - max(16 * k + within + aspect, -56);
  const across = fineness - max(16 * k + within - aspect, -56);
  return [along, across].map((bits) => min(max((bits >> 5) + 1, 0), 16));
}

/** Math.exp, but with the same last bit everywhere. */
function exponential(x) {
  const z = x / 1024;
  let e = 1 + z * (1 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)));
  for (let i = 0; i < 10; i++) e *= e;
  return e;
}

/** What a Gaussian's integers stand for: l1, l2, l3, red, green, blue. */
export function valuesOf(quantum, k, h, u, v, r, colour) {
  const step = 2 ** -h;
  const size = (k & 1 ? 1.4142135623730951 : 1) * 2 ** (k >> 1);
  const within = (u - 0.5) * 0.34657359027997264;
  const l1 = max(size * exponential(within + v * step), fround(0.3));
  const l3 = max(size * exponential(within - v * step), fround(0.3));
  const c = max(quantum / (size * 1.5), 2 ** -16);
  const p = colour[0] * c * 0.57735026918962576;
  const q = colour[1] * c * 0.70710678118654752;
  const s = colour[2] * c * 0.40824829046386302;
  return [l1, r * (2 * step) * l3, l3, p + q + s, p - 2 * s, p - q + s];
}
