// Integers to a payload, and a payload to a file: docs/format.md, "Payload" and "Header".

import { MODEL, edge } from "../coder.js";
import { ALPHA_HEADER, HEADER, crc32 } from "../header.js";
import { groupOf, newMap } from "../map.js";
import { A, A_BY_GROUP, B, B_BY_LUMA, COLOUR_SIGNS, COUNT, DISTANCE, LUMA, LUMA_BY_GROUP } from "../models.js";
import { R, R_BY_DIRECTION, SHAPE_SIGNS, V, V_BY_GROUP, newModels } from "../models.js";
import { level } from "../payload.js";
import { begin, newWriter, packed, symbolOf, write } from "./coder.js";
import { MAX_CLASS } from "./integers.js";

const { abs, floor, log2, max, min } = Math;

const BITS_OF_DISTANCE = 4.4; // and three raw ones, where a Gaussian is expected in every 64 parts

const signsOf = (one, two, three) => 4 * (one < 0) + 2 * (two < 0) + (three < 0);
const levelOf = (value) => level(symbolOf(abs(value)));

/** Write, or count, part and colour of `next`, and shape and place of `now`; either may be missing. gap: parts between
 * them. */
function writeTurn(writer, gap, next, now, grey) {
  const { symbol, fetch, raw } = writer;
  const group = groupOf((next ?? now).k);
  const bucket = now && min(now.h, 7);
  const far = floor(gap / 8);
  const distance = next ? begin(writer, far, DISTANCE) : 0;
  if (now) {
    const { y, a, b } = now;
    symbol(signsOf(y, a, b), COLOUR_SIGNS + 4 * (y !== 0) + 2 * (a !== 0) + (b !== 0));
  }
  if (next) {
    fetch(distance + 3);
    raw(far, distance);
    raw(gap, 3);
  }
  let [y, a, b, v, r] = [0, 0, 0, 0, 0]; // bits behind each symbol
  const [ofY, ofA] = next && !grey ? [levelOf(next.y), levelOf(next.a)] : [];
  if (next) y = begin(writer, abs(next.y), LUMA, LUMA_BY_GROUP + group);
  if (now) v = begin(writer, abs(now.v), V + bucket, V_BY_GROUP + 8 * (group >> 1) + bucket);
  if (next && !grey) a = begin(writer, abs(next.a), A + ofY, A_BY_GROUP + 4 * ofY + (group >> 2));
  if (now) {
    const s = symbolOf(abs(now.v));
    const slant = (s > 0) + (s > 3) + (s > 6);
    r = begin(writer, abs(now.r), R + 6 * bucket + min((s + 1) >> 1, 5), R_BY_DIRECTION + 4 * bucket + slant);
  }
  if (next && !grey) b = begin(writer, abs(next.b), B + ofA, B_BY_LUMA + 4 * ofA + ofY);
  if (now) symbol(signsOf(0, now.v, now.r), SHAPE_SIGNS + 2 * (now.v !== 0) + (now.r !== 0));
  fetch(v + r + (now ? now.uBits : 0) + y + a + b);
  if (now) {
    raw(abs(now.v), v);
    raw(abs(now.r), r);
    raw(now.u, now.uBits);
  }
  if (next) {
    raw(abs(next.y), y);
    raw(abs(next.a), a);
    raw(abs(next.b), b);
  }
  if (now) {
    const { parts, spot } = now;
    const [x, y] = [max(parts[0] - spot.xBits, 0), max(parts[1] - spot.yBits, 0)];
    fetch(x + y);
    raw(spot.px, x);
    raw(spot.py, y);
  }
}

/** A function that estimates the bits of a Gaussian, where it was when it was last written, by these models. */
function estimateBy(models, grey) {
  let bits;
  const symbol = (found, row, second = row) => {
    if (row === DISTANCE) return;
    const [one, two] = [MODEL * row + found, MODEL * second + found];
    bits += 15 - log2(edge(models, one + 1, two + 1) - edge(models, one, two));
  };
  const counter = { symbol, fetch() {}, raw: (_, count) => (bits += count) };
  return (s) => {
    bits = BITS_OF_DISTANCE;
    writeTurn(counter, 0, s, s, grey);
    return bits;
  };
}

/** A number's bits, two places apart. */
const spread = (n) => {
  let code = 0;
  for (let bit = 1, to = 1; bit <= n; bit *= 2, to *= 4) if (n & bit) code += to;
  return code;
};

/** The block of a class in which a Gaussian lies. */
const blockOf = ({ column, row }, { columns, halvings }) =>
  columns * (((row - 2) >> halvings) + 2) + ((column - 2) >> halvings) + 2;

/** The part of its block in which a Gaussian lies. */
function partOf({ column, row, px, py, parts }, { level, halvings }) {
  const along = (cell, part, bits, by) => {
    const place = ((cell - 2) & (2 ** halvings - 1)) * 2 ** bits + part;
    return spread(floor(place * 2 ** (by - halvings - bits)));
  };
  const odd = level & 1;
  const [x, y] = [along(column, px, parts[0], level >> 1), along(row, py, parts[1], (level + 1) >> 1)];
  return (x << odd) + (y << (1 - odd));
}

/** The payload of Gaussians' integers, a list of bytes; and a function that estimates the bits of one, by the models at
 * its end. Each gets a `spot`: what is known of it by its part. */
export function payloadOf(all, header) {
  const models = newModels();
  const writer = newWriter(models);
  if (!all.length) return [[]];
  const sorted = all.slice().sort((one, other) => other.k - one.k);
  const [first, last] = [sorted[0].k, sorted.at(-1).k];
  for (const value of [MAX_CLASS - first, first - last]) {
    writer.fetch(6);
    writer.raw(value, 6);
  }
  const [beginClass, advance, look, , at] = newMap({ ...header, isShort: true });
  for (let k = first; k >= last; k--) {
    const here = sorted.filter((s) => s.k === k);
    write(writer, here.length, COUNT);
    if (!here.length) continue;
    beginClass(k, here.length);
    const blocks = new Map();
    for (const s of here) {
      const block = blockOf(s, at);
      blocks.set(block, [...(blocks.get(block) ?? []), s]);
    }
    let now;
    for (const [block, within] of [...blocks].sort(([one], [other]) => one - other)) {
      let gap = 0;
      while (at.block < block) {
        const rest = 2 ** at.level - at.part;
        gap += rest;
        advance(rest);
      }
      const parts = new Map(within.map((s) => [s, partOf(s, at)]));
      for (const s of within.sort((one, other) => parts.get(one) - parts.get(other))) {
        const on = parts.get(s) - at.part;
        advance(on);
        const [px, py] = [(s.column - 2) * 2 ** s.parts[0] + s.px, (s.row - 2) * 2 ** s.parts[1] + s.py];
        look((s.spot = { px, py }));
        writeTurn(writer, gap + on, s, now, header.grey);
        gap = 0;
        now = s;
      }
    }
    writeTurn(writer, 0, null, now, header.grey);
  }
  return [writer.bytes(), estimateBy(models, header.grey)];
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
