// From an .sg file to its Gaussians.

import { CELL, OCTAVES, SgError, readHeader, refuseUnless, unknown } from "./header.js";
import { readGaussians } from "./payload.js";

const MAX_STRENGTH = 15;

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
 * payload that it needs in `ends`. */
export function readFile(bytes) {
  refuseOthers(bytes);
  const { payload, alpha, ...header } = readHeader(bytes, readTexture);
  return {
    ...header,
    texture: header.texture ?? null,
    alpha: alpha ? { ...alpha, texture: null, ...readPayload(alpha, alpha.payload) } : null,
    payloadBytes: payload.length,
    bytes: bytes.length,
    ...readPayload(header, payload),
  };
}

function readPayload(header, payload) {
  const ends = [];
  const values = readGaussians(header, payload, (isWhole, end) => isWhole && ends.push(end));
  return { count: ends.length, values, ends: Uint32Array.from(ends) };
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
