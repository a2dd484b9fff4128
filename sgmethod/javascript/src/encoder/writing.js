// Integers to a payload, and a payload to a file: docs/format.md, "Payload" and "Header".

import { adapt, edge } from "../coder.js";
import { ALPHA_HEADER, HEADER, crc32 } from "../header.js";
import { A, B, COLOUR_SIGNS, COUNT, DISTANCE, LUMA, R, SHAPE_SIGNS, V, newModels } from "../models.js";
import { level } from "../payload.js";
import { MAX_CLASS, cellsAlong, sideOf } from "./integers.js";

const { abs, floor, log2, max, min } = Math;

const NOTHING = { y: 0, a: 0, b: 0, v: 0, r: 0, u: 0, uBits: 0, px: 0, py: 0, parts: [0, 0], h: 0 };
const BITS_OF_PLACE = 6; // about those of a cell, beside the first distance

/** A number's symbol; of those below 15, how many of its bits follow. */
function symbolOf(value) {
  const top = 31 - Math.clz32(value);
  return value < 4 ? value : min(2 * top + ((value >> (top - 1)) & 1), 15);
}
const bitsAfter = (symbol) => max((symbol >> 1) - 1, 0);

/** Begin a number; returns how many of its bits are still to come. */
function begin({ symbol, fetch, raw }, row, value) {
  const found = symbolOf(value);
  symbol(row, found);
  if (found < 15) return bitsAfter(found);
  const top = 31 - Math.clz32(value);
  fetch(5);
  raw(top, 5);
  fetch(top);
  raw(value, top);
  return 0;
}

const signsOf = (one, two, three) => 4 * (one < 0) + 2 * (two < 0) + (three < 0);
const setOf = (one, two, three) => 4 * (one !== 0) + 2 * (two !== 0) + (three !== 0);
const levelOf = (value) => level(symbolOf(abs(value)));

/** Write cell and colour of `next` and shape and place of `now`, either of which may be missing. by: the distance of
 * their cells, whose last t bits have no model. */
function writeTurn(coder, by, t, next, now, grey) {
  const { symbol, fetch, raw } = coder;
  const [isNext, isNow] = [next !== NOTHING, now !== NOTHING];
  const write = (condition, row, value) => (condition ? begin(coder, row, abs(value)) : 0);
  const far = floor(by / 2 ** t);
  const bucket = min(now.h, 7);
  const distance = write(isNext, DISTANCE, far);
  if (isNow) symbol(COLOUR_SIGNS + setOf(now.y, now.a, now.b), signsOf(now.y, now.a, now.b));
  const y = write(isNext, LUMA, next.y);
  const v = write(isNow, V + bucket, now.v);
  const a = write(isNext && !grey, A + levelOf(next.y), next.a);
  const r = write(isNow, R + bucket, now.r);
  const b = write(isNext && !grey, B + levelOf(next.a), next.b);
  fetch(v + r + now.uBits + (isNext ? t : 0));
  raw(abs(now.v), v);
  raw(abs(now.r), r);
  raw(now.u, now.uBits);
  if (isNow) symbol(SHAPE_SIGNS + setOf(0, now.v, now.r), signsOf(0, now.v, now.r));
  if (isNext) raw(by, t);
  fetch(y + a + b + distance + now.parts[0] + now.parts[1]);
  raw(abs(next.y), y);
  raw(abs(next.a), a);
  raw(abs(next.b), b);
  raw(far, distance);
  raw(now.px, now.parts[0]);
  raw(now.py, now.parts[1]);
}

/** The bits of a number, given those of each symbol. */
function bitsOfNumber(costs, value) {
  const symbol = symbolOf(abs(value));
  return costs[symbol] + (symbol < 15 ? bitsAfter(symbol) : 36 - Math.clz32(abs(value)));
}

/** About the bits of a Gaussian, given those of each symbol of each model. */
export function bitsOf({ y, a, b, v, r, h, uBits, parts }, costs, grey) {
  const bucket = min(h, 7);
  let bits = BITS_OF_PLACE + costs[DISTANCE][0] + uBits + parts[0] + parts[1] + bitsOfNumber(costs[LUMA], y);
  if (!grey) bits += bitsOfNumber(costs[A + levelOf(y)], a) + bitsOfNumber(costs[B + levelOf(a)], b);
  bits += bitsOfNumber(costs[V + bucket], v) + bitsOfNumber(costs[R + bucket], r);
  bits += costs[COLOUR_SIGNS + setOf(y, a, b)][signsOf(y, a, b)];
  return bits + costs[SHAPE_SIGNS + setOf(0, v, r)][signsOf(0, v, r)];
}

/** Bytes of bits, the first of which is the least significant, or the most. */
function packed(bits, isFirstMost) {
  const bytes = new Uint8Array((bits.length + 7) >> 3);
  bits.forEach((bit, i) => (bytes[i >> 3] |= bit << (isFirstMost ? 7 - (i & 7) : i & 7)));
  return bytes;
}

/** Collects what is to be coded; the entropy coder works backwards, so that bytes come at the end. */
function newWriter() {
  const models = newModels();
  const steps = []; // of a symbol, where its share of 32768 begins and how much it is; or [0, 0, bits to be fetched]
  const queue = [];
  const symbol = (row, found) => {
    const low = edge(models[row], found);
    steps.push([low, edge(models[row], found + 1) - low]);
    adapt(models[row], found);
  };
  const fetch = (count) => steps.push([0, 0, count]);
  const raw = (value, count) => {
    for (let i = 0; i < count; i++) queue.push(floor(value / 2 ** i) & 1);
  };
  const bytes = () => {
    const words = [];
    let state = 65536;
    for (let i = steps.length - 1; i >= 0; i--) {
      const [low, share] = steps[i];
      if (!share) continue;
      if (state >= share * 131072) {
        words[i] = state % 65536;
        state = floor(state / 65536);
      }
      state = floor(state / share) * 32768 + (state % share) + low;
    }
    const out = [state & 255, (state >>> 8) & 255, (state >>> 16) & 255, state >>> 24];
    const rawBytes = packed(queue, false);
    let [left, head] = [0, 0];
    steps.forEach(([, share, count], i) => {
      if (words[i] !== undefined) out.push(words[i] & 255, words[i] >> 8);
      if (share) return;
      for (; left < count; left += 8) out.push(rawBytes[head++]);
      left -= count;
    });
    return out;
  };
  const cost = (model) => Float64Array.from({ length: 16 }, (_, i) => 15 - log2(edge(model, i + 1) - edge(model, i)));
  return { symbol, fetch, raw, bytes, costs: () => models.map(cost) };
}

/** Every other bit of a Morton code. */
const spread = (n) => {
  let code = 0;
  for (let bit = 1, to = 1; bit <= n; bit *= 2, to *= 4) if (n & bit) code += to;
  return code;
};

/** The payload of Gaussians' integers, a list of bytes; and the bits of each symbol of each model at its end. */
export function payloadOf(all, header) {
  const writer = newWriter();
  if (!all.length) return [[], writer.costs()];
  const coded = all.map((s) => ({ ...s, cell: spread(s.column) + 2 * spread(s.row) }));
  coded.sort((one, other) => other.k - one.k || one.cell - other.cell);
  const [first, last] = [coded[0].k, coded.at(-1).k];
  for (const value of [MAX_CLASS - first, first - last]) {
    writer.fetch(6);
    writer.raw(value, 6);
  }
  for (let k = first; k >= last; k--) {
    const here = coded.filter((s) => s.k === k);
    const n = here.length;
    const rest = begin(writer, COUNT, n);
    writer.fetch(rest);
    writer.raw(n, rest);
    const side = sideOf(k);
    const cells = cellsAlong(header.width, side) * cellsAlong(header.height, side);
    let t = 0;
    for (let mean = floor(cells / max(n, 1)); mean >= 8; mean /= 2) t++;
    for (let i = 0; i <= n && n; i++) {
      const by = i < n ? here[i].cell - (i ? here[i - 1].cell : 0) : 0;
      writeTurn(writer, by, min(t, 24), here[i] ?? NOTHING, here[i - 1] ?? NOTHING, header.grey);
    }
  }
  return [writer.bytes(), writer.costs()];
}

/** A short file. header and alpha, if there is one: width, height, code of the quantum, background of five bits a
 * channel, grey, payload. */
export function fileOf(header, alpha) {
  const bits = [];
  const write = (value, count) => {
    for (let i = count - 1; i >= 0; i--) bits.push((value >> i) & 1);
  };
  const field = ([, shortBits, grows], value) => {
    const top = 31 - Math.clz32(value);
    write(grows ? top : value, shortBits);
    if (grows) write(value, top);
  };
  const { width, height, code, background, grey } = header;
  const values = [16 + (alpha ? 8 : 0) + (grey ? 1 : 0), width, height, code, ...background.slice(0, grey ? 1 : 3)];
  values.forEach((value, i) => field(HEADER[i], value));
  if (alpha)
    [alpha.code, alpha.background[0], alpha.payload.length + 1].forEach((value, i) => field(ALPHA_HEADER[i], value));
  const bytes = [0xd3, 0xc2, ...packed(bits, true), ...(alpha?.payload ?? []), ...header.payload];
  return Uint8Array.of(...bytes, crc32(bytes) & 255);
}
