// Integers to a payload, and a payload to a file: docs/format.md, "Payload" and "Header".

import { MODEL, bitsAfter, edge } from "../coder.js";
import { ALPHA_HEADER, HEADER, crc32 } from "../header.js";
import { groupOf, newMap } from "../map.js";
import { A, A_BY_GROUP, B, B_BY_LUMA, COLOUR_SIGNS, COUNT, DISTANCE, LUMA, LUMA_BY_GROUP } from "../models.js";
import { R, R_BY_DIRECTION, SHAPE_SIGNS, V, V_BY_GROUP, newModels } from "../models.js";
import { level } from "../payload.js";
import { begin, newWriter, packed, symbolOf, write } from "./coder.js";
import { MAX_CLASS } from "./integers.js";

const { abs, floor, log2, max, min } = Math;

const BITS_OF_DISTANCE = 7.4; // where a Gaussian is expected in every 64 parts

const signsOf = (one, two, three) => 4 * (one < 0) + 2 * (two < 0) + (three < 0);
const levelOf = (value) => level(symbolOf(abs(value)));

/** The rows of a Gaussian's models; of a symbol or a number, one or two. */
function rowsOf({ k, y, a, b, v, r, h }) {
  const group = groupOf(k);
  const bucket = min(h, 7);
  const s = symbolOf(abs(v));
  const slant = (s > 0) + (s > 3) + (s > 6);
  return {
    y: [LUMA, LUMA_BY_GROUP + group],
    a: [A + levelOf(y), A_BY_GROUP + 4 * levelOf(y) + (group >> 2)],
    b: [B + levelOf(a), B_BY_LUMA + 4 * levelOf(a) + levelOf(y)],
    colourSigns: COLOUR_SIGNS + 4 * (y !== 0) + 2 * (a !== 0) + (b !== 0),
    v: [V + bucket, V_BY_GROUP + 8 * (group >> 1) + bucket],
    r: [R + 6 * bucket + min((s + 1) >> 1, 5), R_BY_DIRECTION + 4 * bucket + slant],
    shapeSigns: SHAPE_SIGNS + 2 * (v !== 0) + (r !== 0),
  };
}

/** By how many bits a Gaussian's place is divided further than by its part, along x and y. */
const bitsOfPlace = ({ parts, spot }) => [max(parts[0] - spot.xBits, 0), max(parts[1] - spot.yBits, 0)];

/** Write part and colour of `next`, and shape and place of `now`; either may be missing. gap: parts between them. */
function writeTurn(writer, gap, next, now, grey) {
  const { symbol, fetch, raw } = writer;
  const [ofNext, ofNow] = [next && rowsOf(next), now && rowsOf(now)];
  const number = (s, name, rows) => (s ? begin(writer, abs(s[name]), ...rows[name]) : 0);
  const far = floor(gap / 8);
  const distance = next ? begin(writer, far, DISTANCE) : 0;
  if (now) symbol(signsOf(now.y, now.a, now.b), ofNow.colourSigns);
  if (next) {
    fetch(distance + 3);
    raw(far, distance);
    raw(gap, 3);
  }
  const y = number(next, "y", ofNext);
  const v = number(now, "v", ofNow);
  const a = number(!grey && next, "a", ofNext);
  const r = number(now, "r", ofNow);
  const b = number(!grey && next, "b", ofNext);
  if (now) symbol(signsOf(0, now.v, now.r), ofNow.shapeSigns);
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
    const [x, y] = bitsOfPlace(now);
    fetch(x + y);
    raw((now.column - 2) * 2 ** now.parts[0] + now.px, x);
    raw((now.row - 2) * 2 ** now.parts[1] + now.py, y);
  }
}

/** The bits of a symbol by these models. */
function bitsOfSymbol(models, symbol, row, second = row) {
  const [one, two] = [MODEL * row + symbol, MODEL * second + symbol];
  return 15 - log2(edge(models, one + 1, two + 1) - edge(models, one, two));
}

/** About the bits of a Gaussian, where it was when it was last written. */
export function bitsOf(s, models, grey) {
  const rows = rowsOf(s);
  const [x, y] = bitsOfPlace(s);
  let bits = BITS_OF_DISTANCE + s.uBits + x + y;
  for (const name of grey ? ["y", "v", "r"] : ["y", "a", "b", "v", "r"]) {
    const value = abs(s[name]);
    const symbol = symbolOf(value);
    bits += bitsOfSymbol(models, symbol, ...rows[name]);
    bits += symbol < 15 ? bitsAfter(symbol) : 36 - Math.clz32(value);
  }
  bits += bitsOfSymbol(models, signsOf(s.y, s.a, s.b), rows.colourSigns);
  return bits + bitsOfSymbol(models, signsOf(0, s.v, s.r), rows.shapeSigns);
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

/** The payload of Gaussians' integers, a list of bytes; and the models at its end. Each gets a `spot`: what is known of
 * it by its part. */
export function payloadOf(all, header) {
  const models = newModels();
  const writer = newWriter(models);
  if (!all.length) return [[], models];
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
        look((s.spot = {}));
        writeTurn(writer, gap + on, s, now, header.grey);
        gap = 0;
        now = s;
      }
    }
    writeTurn(writer, 0, null, now, header.grey);
  }
  return [writer.bytes(), models];
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
