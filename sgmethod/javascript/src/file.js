// From an .sg file to its Gaussians, and the bits that each took.

import { CELL, OCTAVES, SgError, readHeader, refuseUnless, unknown } from "./header.js";
import { A, ALL, B, COLOUR_SIGNS, DISTANCE, LUMA, R, SHAPE_SIGNS, V } from "./models.js";
import { MAPPED_LUMA, MAPPED_R, MAPPED_SIGNS, MAPPED_V } from "./models.js";
import { readGaussians } from "./payload.js";

const MAX_STRENGTH = 15;
// What the bits of a model describe, by its first row.
const FIRST_ROWS = {
  [DISTANCE]: "place",
  [LUMA]: "light",
  [A]: "tint",
  [B]: "tint",
  [COLOUR_SIGNS]: "light",
  [V]: "shape",
  [R]: "slant",
  [SHAPE_SIGNS]: "shape",
  [MAPPED_LUMA]: "light",
  [MAPPED_V]: "shape",
  [MAPPED_R]: "slant",
  [MAPPED_SIGNS]: "shape",
};
// The same by each row; the count of Gaussians describes none.
const described = [];
for (let row = DISTANCE; row < ALL; row++) described[row] = FIRST_ROWS[row] ?? described[row - 1];

function refuseOthers([first, second]) {
  if (first === 0xd3 && second === 0xc2) return;
  if (first === 0xd3 && second >> 4 === 12) throw unknown("this version of the file is not known here");
  throw new SgError("this is no .sg file");
}

/** Codes of texture's strength for each octave, row by row. */
function readTexture(bit, width, height) {
  const [columns, rows] = [Math.ceil(width / CELL), Math.ceil(height / CELL)];
  const octaves = [];
  for (let octave = 0; octave < OCTAVES; octave++) {
    const sums = new Int32Array(columns * rows);
    const codes = sums.map((_, i) => {
      let ones = 0;
      while (bit()) ones++;
      const before = i % columns ? sums[i - 1] : i ? sums[i - columns] : 0;
      sums[i] = before + (ones & 1 ? -(ones + 1) / 2 : ones / 2);
      const code = sums[i] + (octave ? octaves[octave - 1][i] : 0);
      refuseUnless(code >= 0 && code <= MAX_STRENGTH, "a strength of texture is out of range");
      return code;
    });
    octaves.push(codes);
  }
  return { columns, rows, octaves };
}

/** Header and Gaussians of a file. Throws SgError.
 *
 * In the file's order, each Gaussian has 8 numbers in `values` (x, y, l1, l2, l3, red, green, blue), and the bytes of the
 * payload that it needs in `ends`. With costs, each has the bits that it took in `bits`, and `spent` sums these by what
 * they describe. */
export function readFile(bytes, { costs = false } = {}) {
  refuseOthers(bytes);
  const { payload, alpha, parts, ...header } = readHeader(bytes, readTexture);
  const [textureAt, alphaAt, payloadAt, end] = parts;
  const read = costs ? readWithCosts : readPayload;
  return {
    ...header,
    texture: header.texture ?? null,
    alpha: alpha ? { ...alpha, texture: null, ...read(alpha, alpha.payload) } : null,
    headerBytes: textureAt + bytes.length - end,
    textureBytes: alphaAt - textureAt,
    alphaBytes: payloadAt - alphaAt,
    payloadBytes: payload.length,
    bytes: bytes.length,
    ...read(header, payload),
  };
}

function readPayload(header, payload, onTurn, onCost) {
  const ends = [];
  const values = readGaussians(
    header,
    payload,
    (isWhole, end) => {
      if (isWhole) ends.push(end);
      onTurn?.(isWhole);
    },
    onCost,
  );
  return { count: ends.length, values, ends: Uint32Array.from(ends) };
}

function readWithCosts(header, payload) {
  const spent = { place: 0, shape: 0, slant: 0, light: 0, tint: 0 };
  const bits = [];
  let [now, next] = [0, 0]; // bits of the two Gaussians in a turn
  const onTurn = (isWhole) => {
    if (isWhole) bits.push(now);
    [now, next] = [next, 0];
  };
  const onCost = (cost, state, row) => {
    if (!described[row]) return;
    spent[described[row]] += cost;
    if (state) now += cost;
    else next += cost;
  };
  return { ...readPayload(header, payload, onTurn, onCost), spent, bits: Float32Array.from(bits) };
}

/** How many Gaussians the first part of a file holds; part: above 0 to 1. */
export function countInPart(file, part) {
  if (part >= 1) return file.count;
  const bytes = Math.ceil(part * file.payloadBytes);
  let [low, high] = [0, Math.min(file.count, 3 * bytes + 64)];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (file.ends[middle - 1] <= bytes) low = middle;
    else high = middle - 1;
  }
  return low;
}
