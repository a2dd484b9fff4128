// An .sg file to its Gaussians, and what each of them cost.

import { CELL, OCTAVES, SgError, readHeader, refuseUnless, unknown } from "./header.js";
import { A, B, COLOUR_SIGNS, COUNT, DISTANCE, LUMA, R, SHAPE_SIGNS, V } from "./models.js";
import { readGaussians } from "./payload.js";

const MOST_STRENGTH = 15;
// What the bits of a model, and those that follow it, say of a Gaussian.
const SAYS = {
  [DISTANCE]: "place",
  [LUMA]: "light",
  [A]: "tint",
  [B]: "tint",
  [COLOUR_SIGNS]: "light",
  [V]: "shape",
  [R]: "slant",
  [SHAPE_SIGNS]: "shape",
};
const saying = Array.from({ length: SHAPE_SIGNS + 4 }, (_, row) => row);
saying.forEach((row) => (saying[row] = SAYS[row] ?? (row === COUNT ? undefined : saying[row - 1])));

function refuseOthers([first, second]) {
  if (first === 0xd3 && second === 0xc2) return;
  if (first === 0xd3 && second >> 4 === 12)
    throw unknown("this version of the file is not known here");
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
      refuseUnless(code >= 0 && code <= MOST_STRENGTH, "a strength of texture is out of range");
      return code;
    });
    octaves.push(codes);
  }
  return { columns, rows, octaves };
}

/** Header and Gaussians of a file. Throws SgError.
 *
 * The Gaussians are in the file's order: each has 8 numbers in `values` (x, y, l1, l2, l3, red, green, blue), how many
 * bits it took in `bits`, and in `ends` how many bytes of the payload are needed for it. `spent` has the bits by what
 * they say of all Gaussians. */
export function readFile(bytes) {
  refuseOthers(bytes);
  const { payload, alpha, parts, ...header } = readHeader(bytes, readTexture);
  const [textureAt, alphaAt, payloadAt, end] = parts;
  return {
    ...header,
    texture: header.texture ?? null,
    alpha: alpha ? { ...alpha, texture: null, ...readPayload(alpha, alpha.payload) } : null,
    headerBytes: textureAt + bytes.length - end,
    textureBytes: alphaAt - textureAt,
    alphaBytes: payloadAt - alphaAt,
    payloadBytes: payload.length,
    bytes: bytes.length,
    ...readPayload(header, payload),
  };
}

function readPayload(header, payload) {
  const spent = { place: 0, shape: 0, slant: 0, light: 0, tint: 0 };
  const [values, bits, ends] = [[], [], []];
  let [now, next] = [0, 0]; // bits of the two Gaussians in a turn
  const found = (its, end) => {
    if (its) {
      values.push(...its);
      bits.push(now);
      ends.push(end);
    }
    [now, next] = [next, 0];
  };
  const told = (cost, state, row) => {
    if (!saying[row]) return;
    spent[saying[row]] += cost;
    if (state) now += cost;
    else next += cost;
  };
  readGaussians(header, payload, found, told);
  const [typed, cost, last] = [Float32Array.from(values), Float32Array.from(bits), Uint32Array.from(ends)];
  return { spent, count: bits.length, values: typed, bits: cost, ends: last };
}

/** How many of the Gaussians are in the first part of a file, above 0 to 1. */
export function countInPart(file, part) {
  if (part >= 1) return file.count;
  const bytes = Math.ceil(part * file.payloadBytes);
  let [low, high] = [0, Math.min(file.count, 8 * bytes + 64)];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (file.ends[middle - 1] <= bytes) low = middle;
    else high = middle - 1;
  }
  return low;
}
