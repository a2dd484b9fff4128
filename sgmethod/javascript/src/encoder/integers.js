// Gaussians to a file's integers: docs/format.md, "Bits of a Gaussian" and "Integers to Gaussians", backwards.

import { log2, partBits, valuesOf } from "../payload.js";

const { floor, log, max, min, round, sqrt } = Math;

export const MAX_CLASS = 28;
export const FINEST = 208; // code of a quantum
const MIN_CLASS = -4;
const MAX_COLOUR = 2 ** 22;
const FARTHEST = 65536; // cells along a side at most

const clamp = (value, low, high) => min(max(value, low), high);

/** The quantum of a short file's code, 0 to 255; the larger, the finer. */
export const quantumOf = (code) => (1 + (((code & 15) << 4) | (code >> 4)) / 256) * 2 ** (3 - (code >> 4));

/** A grid of cells: as wide as this, this many columns and rows. */
export function cellsOf(k, { width, height }) {
  const side = 2 ** max(0, (k + 1) >> 1);
  return [side, ...[width, height].map((pixels) => min(floor(pixels / side) + 5, FARTHEST))];
}

/** Integers with the Gaussian that they stand for, as `g`. */
export function withGaussian(s, header) {
  const { k, h, y, a, b, v, r } = s;
  const u = (s.u + 0.5) / 2 ** s.uBits;
  const [side] = cellsOf(k, header);
  const place = [s.column - 2 + (s.px + 0.5) / 2 ** s.parts[0], s.row - 2 + (s.py + 0.5) / 2 ** s.parts[1]];
  const g = Float64Array.of(place[0] * side, place[1] * side, ...valuesOf(header.quantum, k, h, u, v, r, [y, a, b]));
  return { ...s, g };
}

/** The integers of a Gaussian; null if nothing is left of its colour. */
export function rounded([x, y, l1, l2, l3, red, green, blue], header) {
  const size = log(l1 * l3) / Math.LN2; // in classes
  const k = clamp(round(size), MIN_CLASS, MAX_CLASS);
  const c = max(header.quantum / (2 ** (k / 2) * 1.5), 2 ** -16);
  const axes = [(red + green + blue) / sqrt(3), (red - blue) / sqrt(2), (red - 2 * green + blue) / sqrt(6)];
  const colour = axes.map((axis, i) => (i && header.grey ? 0 : clamp(round(axis / c), -MAX_COLOUR, MAX_COLOUR)));
  const square = colour.reduce((sum, part) => sum + part * part, 0);
  if (!square) return null;
  const h = min((log2(square) + 1) >> 1, 18);
  const uBits = min(max(h - 1, 0), 12);
  const [levels, steps] = [2 ** uBits, 2 ** h];
  const u = clamp(floor((size - k + 0.5) * levels), 0, levels - 1);
  const v = clamp(round((log(l1 / l3) / 2) * steps), -8 * steps, 8 * steps);
  // Chosen for the slope l2 / l1 to be right with the l1 and l3 that are decoded.
  const [flat1, , flat3] = valuesOf(header.quantum, k, h, (u + 0.5) / levels, v, 0, colour);
  const r = clamp(round(((l2 / l1) * flat1 * steps) / (2 * flat3)), -2048 * steps, 2048 * steps);
  const parts = partBits(k, square, h, (u + 0.5) / levels, v, r);
  const [side, columns, rows] = cellsOf(k, header);
  const nearest = (at, cells, bits) => {
    const cell = clamp(floor(at / side + 2), 0, cells - 1);
    return [cell, clamp(floor((at / side + 2 - cell) * 2 ** bits), 0, 2 ** bits - 1)];
  };
  const [[column, px], [row, py]] = [nearest(x, columns, parts[0]), nearest(y, rows, parts[1])];
  return withGaussian(
    { k, y: colour[0], a: colour[1], b: colour[2], h, uBits, u, v, r, parts, column, row, px, py },
    header,
  );
}
