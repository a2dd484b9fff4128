// Gaussians to a file's integers: docs/format.md, "Bits of a Gaussian" and "Integers to Gaussians", backwards.

import { quantumOf } from "../header.js";
import { cellsOf, partBits, shapeBits, valuesOf } from "../payload.js";

const { floor, log, max, min, round, sqrt } = Math;

export const MAX_CLASS = 28;
export const FINEST = 208; // code of a quantum
const MIN_CLASS = -4;
const MAX_COLOUR = 2 ** 22;

/** The quantum of a short file's code of 8 bits. */
export const shortQuantumOf = (code) => quantumOf((code << 4) | (code >> 4));

const clamp = (value, low, high) => min(max(value, low), high);

/** Integers with the Gaussian that they stand for, as `g`. */
export function withGaussian(s, header) {
  const { k, h, y, a, b, v, r } = s;
  const u = (s.u + 0.5) / 2 ** s.uBits;
  const [side] = cellsOf(k, header.width, header.height);
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
  const [h, uBits] = shapeBits(square);
  const [levels, steps] = [2 ** uBits, 2 ** h];
  const u = clamp(floor((size - k + 0.5) * levels), 0, levels - 1);
  const v = clamp(round((log(l1 / l3) / 2) * steps), -8 * steps, 8 * steps);
  // Chosen for the slope l2 / l1 to be right with the l1 and l3 that are decoded.
  const [flat1, , flat3] = valuesOf(header.quantum, k, h, (u + 0.5) / levels, v, 0, colour);
  const r = clamp(round(((l2 / l1) * flat1 * steps) / (2 * flat3)), -2048 * steps, 2048 * steps);
  const parts = partBits(k, square, h, (u + 0.5) / levels, v, r);
  const [side, columns, rows] = cellsOf(k, header.width, header.height);
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
