// A payload to its Gaussians: docs/format.md, "Payload" and "Integers to Gaussians".
// The label WHOLE: header.js.

import { newCoder } from "./coder.js";
import { floor, fround, max, min, refuseUnless } from "./header.js";
import { groupOf, lg, newMap } from "./map.js";
import { A, A_BY_GROUP, B, B_BY_LUMA, COLOUR_SIGNS, COUNT, DISTANCE, LUMA_BY_GROUP } from "./models.js";
import { R, V, V_BY_GROUP, newModels } from "./models.js";

const COLOUR = 0; // the states
const SHAPE = 1;

/** Decode a payload's Gaussians, in its order: x, y, l1, l2, l3, red, green and blue of each. onTurn(isWhole, end) is
 * called after each turn, with whether it completed a Gaussian, and the bytes read so far. Throws SgError. */
export function readGaussians({ width, height, isShort, quantum, grey, upright }, payload, onTurn) {
  let values = new Float32Array(0);
  if (!payload.length) return values;
  const [symbol, number, fetch, take, whole, bytesRead, isEnded] = newCoder(payload, newModels(), isShort);
  const [begin, advance, look, add] = newMap({ width, height, isShort });
  const refuseOverrun = () => refuseUnless(bytesRead() <= payload.length, "it ends too early");
  const limit = min(width * height, 2 ** 24, 3 * payload.length + 64);
  let [now, next] = [{}, {}]; // a Gaussian whose place is incomplete, and the one behind it
  let at = 0; // in values
  fetch(6);
  let k = 28 - take(6);
  fetch(6);
  const last = k - take(6);
  WHOLE: refuseUnless(last >= -4, "a class is out of range");
  for (; k >= last; k--) {
    const count = number(COLOUR, COUNT);
    fetch(0);
    const n = whole(count);
    refuseOverrun();
    refuseUnless(at / 8 + n <= limit, "it has too many Gaussians");
    if (!n) continue;
    const larger = new Float32Array(at + 8 * n);
    larger.set(values);
    values = larger;
    const group = groupOf(k);
    const side = 2 ** max(0, (k + 1) >> 1);
    const place = (first, part, told, bits, pixels) => {
      const more = bits - told;
      fetch(max(more, 0)); // the bytes that both at once would be, of which numbers of 53 bits could not hold all
      const within = more > 0 ? part * 2 ** more + take(more) : part >> -more;
      const cell = (within + 0.5) / 2 ** bits + first;
      WHOLE: {
        const isWithin = cell >= -2 && cell < min(floor((pixels - 1) / side) + 5, 65536) - 2;
        refuseUnless(isWithin, "a place is out of range");
      }
      return cell * side;
    };
    begin(k, n);
    now.h = now.uBits = 0;
    // A turn holds part and colour of the next Gaussian, then shape and place of the one before it.
    for (let i = 0; i <= n; i++) {
      const isMore = i < n;
      const { h, uBits } = now;
      const bucket = min(h, 7);
      const distance = isMore && number(COLOUR, DISTANCE);
      if (i) {
        const signs = symbol(SHAPE, COLOUR_SIGNS + 4 * (now.y > 0) + 2 * (now.a > 0) + (now.b > 0));
        if (signs & 4) now.y = -now.y;
        if (signs & 2) now.a = -now.a;
        if (signs & 1) now.b = -now.b;
      }
      if (isMore) {
        fetch(3);
        advance(8 * whole(distance) + take(3));
        look(next);
      }
      const y = isMore && number(COLOUR, next.lumaRow, LUMA_BY_GROUP + group);
      let v = i && number(SHAPE, now.vRow + bucket, V_BY_GROUP + 8 * (group >> 1) + bucket);
      const a = isMore && !grey && number(COLOUR, A + level(y), A_BY_GROUP + 4 * level(y) + (group >> 2));
      const slant = (v > 0) + (v > 3) + (v > 6);
      let r =
        i &&
        !upright &&
        number(SHAPE, R + 6 * bucket + (min(v + 1, 10) >> 1), now.rRow + 4 * bucket + slant);
      const b = isMore && !grey && number(COLOUR, B + level(a), B_BY_LUMA + 4 * level(a) + level(y));
      const signs = i && symbol(SHAPE, now.signsRow + 2 * (v > 0) + (r > 0));
      fetch(uBits);
      v = whole(v);
      r = whole(r);
      const u = (take(uBits) + 0.5) / 2 ** uBits;
      WHOLE: refuseUnless(v <= 8 * 2 ** h && r <= 2048 * 2 ** h, "a shape is out of range");
      if (signs & 2) v = -v;
      if (signs & 1) r = -r;
      if (isMore) {
        next.y = whole(y);
        next.a = whole(a);
        next.b = whole(b);
        next.square = next.y ** 2 + next.a ** 2 + next.b ** 2;
        WHOLE: refuseUnless(next.square, "a Gaussian has no colour");
        WHOLE: refuseUnless(max(next.y, next.a, next.b) <= 2 ** 22, "a colour is out of range");
        next.h = exponentOf(next.square);
        next.uBits = min(max(next.h - 1, 0), 12);
      }
      if (i) {
        const px = partBits(k, now.square, h, u, v, r, 1);
        const py = partBits(k, now.square, h, u, v, r, -1);
        values[at] = place(now.left, now.across, now.xBits, px, width);
        values[at + 1] = place(now.top, now.down, now.yBits, py, height);
        setShape(values, at, quantum, k, h, u, v, r, now);
        refuseOverrun();
        WHOLE: add(now.square * 2 ** (-2 - k), values, at);
        at += 8;
      }
      WHOLE: onTurn?.(i > 0, bytesRead());
      const free = now;
      now = next;
      next = free;
    }
  }
  refuseUnless(isEnded(), "its end is wrong");
  return values;
}

/** Which of a colour's models is next, by the symbol before. */
export const level = (symbol) => (symbol > 0) + (symbol > 2) + (symbol > 5);

/** The power of two nearest to a colour, by its square; 0 for none, which no file may have. */
export const exponentOf = (square) => min(max(((lg(square) >> 4) + 1) >> 1, 0), 18);

/** lg(4^h + 4 r^2), also where that has more than 53 bits. */
function lgOfSquares(h, r) {
  const squares = 4 ** h + 4 * r * r;
  WHOLE: if (squares >= 2 ** 53) {
    const exact = 4n ** BigInt(h) + 4n * BigInt(r) ** 2n;
    const n = exact.toString(2).length - 1;
    return 16 * n + Number(exact >> BigInt(n - 4)) - 16;
  }
  return lg(squares);
}

/** How many bits divide the cell along x (sign = 1) or y (-1). */
export function partBits(k, square, h, u, v, r, sign) {
  const size = 16 * k + floor(16 * u) - 8 + sign * floor((46 * v) / 2 ** h);
  const slant = sign > 0 ? lgOfSquares(h, r) - 32 * h : 0;
  const bits = lg(square) + 32 * max(0, (k + 1) >> 1) - 17 + slant - max(size, -56);
  return min(max((bits >> 5) + 1, 0), 16);
}

/** Math.exp, but with the same last bit everywhere. */
function exponential(x) {
  const z = x / 1024;
  let e = 1 + z * (1 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)));
  for (let i = 0; i < 10; i++) e *= e;
  return e;
}

/** Set what a Gaussian's integers stand for: l1, l2, l3, red, green, blue, from the third number of its eight on. */
export function setShape(values, at, quantum, k, h, u, v, r, { y, a, b }) {
  const step = 2 ** -h;
  const size = (k & 1 ? 1.4142135623730951 : 1) * 2 ** (k >> 1);
  const within = (u - 0.5) * 0.34657359027997264;
  const l3 = max(size * exponential(within - v * step), fround(0.3));
  const c = max(quantum / (size * 1.5), 2 ** -16);
  const p = y * c * 0.57735026918962576;
  const q = a * c * 0.70710678118654752;
  const s = b * c * 0.40824829046386302;
  values[at + 2] = max(size * exponential(within + v * step), fround(0.3));
  values[at + 3] = r * (2 * step) * l3;
  values[at + 4] = l3;
  values[at + 5] = p + q + s;
  values[at + 6] = p - 2 * s;
  values[at + 7] = p - q + s;
}
