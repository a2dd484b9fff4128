// Gaussians to a file's integers: docs/format.md, "Bits of a Gaussian" and "Integers to Gaussians", backwards.

import { exponentOf, partBits, setShape } from "../payload.js";

const { floor, log, max, min, round, sqrt } = Math;

export const MAX_CLASS = 28;
export const FINEST = 223; // quantum, in order
const MIN_CLASS = -4;
const MAX_COLOUR = 2 ** 22;
const FARTHEST = 65536; // cells along a side at most

const clamp = (value, low, high) => min(max(value, low), high);

/** The code of a short file's quantum, which are in order here, from the coarsest on; and the quantum. */
export const codeOf = (n) => n ^ 15;
export const quantumOf = (n) => (1 + ((codeOf(n & 15) << 4) | (n >> 4)) / 256) * 2 ** (3 - (n >> 4));

/** The code of a background in a short file, and its level. */
export const fiveBits = (level) => clamp(round((255 * level - 3.5) / 8.26), 0, 31);
export const levelOf = (code) => (8 * code + (code >> 2)) / 255;

/** How wide a class's cells are, in pixels, and how many of them lie along a side of the picture. */
const sideOf = (k) => 2 ** max(0, (k + 1) >> 1);
const cellsAlong = (pixels, side) => min(floor((pixels - 1) / side) + 5, FARTHEST);

/** Set the Gaussian that integers stand for, as their `g`, and return them. */
export function withGaussian(s, { quantum }) {
  const { k, h, uBits, parts } = s;
  const side = sideOf(k);
  s.g = new Float64Array(8);
  s.g[0] = side * (s.column - 2 + (s.px + 0.5) / 2 ** parts[0]);
  s.g[1] = side * (s.row - 2 + (s.py + 0.5) / 2 ** parts[1]);
  setShape(s.g, 0, quantum, k, h, (s.u + 0.5) / 2 ** uBits, s.v, s.r, s);
  return s;
}

const integer = (value, limit) => clamp(round(value), -limit, limit) | 0;

/** The integers of a Gaussian, with the one that they stand for as `g`; null if nothing is left of its colour. spot: what
 * was known of it by its part when it was last written. */
export function rounded(g, header, spot) {
  const { width, height, quantum, grey } = header;
  const [red, green, blue] = [g[5], g[6], g[7]];
  const size = log(g[2] * g[4]) / Math.LN2; // in classes
  const k = clamp(round(size), MIN_CLASS, MAX_CLASS) | 0;
  const step = max(quantum / (2 ** (k / 2) * 1.5), 2 ** -16);
  const y = integer((red + green + blue) / (sqrt(3) * step), MAX_COLOUR);
  const a = grey ? 0 : integer((red - blue) / (sqrt(2) * step), MAX_COLOUR);
  const b = grey ? 0 : integer((red - 2 * green + blue) / (sqrt(6) * step), MAX_COLOUR);
  const square = y * y + a * a + b * b;
  if (!square) return null;
  const h = exponentOf(square);
  const uBits = min(max(h - 1, 0), 12);
  const steps = 2 ** h;
  const u = clamp(floor((size - k + 0.5) * 2 ** uBits), 0, 2 ** uBits - 1);
  const v = integer((log(g[2] / g[4]) / 2) * steps, 8 * steps);
  const within = (u + 0.5) / 2 ** uBits;
  // Chosen for the slope l2 / l1 to be right with the l1 and l3 that are decoded.
  const flat = new Float64Array(8);
  setShape(flat, 0, quantum, k, h, within, v, 0, { y, a, b });
  const r = integer(((g[3] / g[2]) * flat[2] * steps) / (2 * flat[4]), 2048 * steps);
  const parts = [1, -1].map((sign) => partBits(k, square, h, within, v, r, sign));
  const side = sideOf(k);
  const column = clamp(floor(g[0] / side + 2), 0, cellsAlong(width, side) - 1);
  const row = clamp(floor(g[1] / side + 2), 0, cellsAlong(height, side) - 1);
  const px = clamp(floor((g[0] / side + 2 - column) * 2 ** parts[0]), 0, 2 ** parts[0] - 1);
  const py = clamp(floor((g[1] / side + 2 - row) * 2 ** parts[1]), 0, 2 ** parts[1] - 1);
  return withGaussian({ k, y, a, b, square, h, uBits, u, v, r, parts, column, row, px, py, g: null, spot }, header);
}
