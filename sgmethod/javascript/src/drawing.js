// A view of a file: docs/format.md, "Views" and "Noise".

import { CELL, OCTAVES, SgError, unknown } from "./header.js";
import { drawGaussians, rounded, setAlpha } from "./planes.js";

export const MAX_PIXELS = 50e6;
export const MAX_SCALE = 64; // and 1 / 64 at least

/** Which part of the picture a view shows, and how large. Throws SgError. */
function viewOf(file, scale = 1, region = null) {
  const [x, y, w, h] = region ?? [0, 0, file.width, file.height];
  const within = x >= 0 && y >= 0 && w >= 1 && h >= 1 && x + w <= file.width && y + h <= file.height;
  const isScale = scale >= 1 / MAX_SCALE && scale <= MAX_SCALE;
  if (!isScale || !within) throw new SgError("this view is not in the picture");
  const [width, height] = [Math.max(rounded(w * scale), 1), Math.max(rounded(h * scale), 1)];
  if (width * height > MAX_PIXELS) throw unknown("the picture is too large to be drawn here");
  const [sx, sy] = [width / w, height / h];
  const [left, top] = [Math.floor(x * sx) % 65536, Math.floor(y * sy) % 65536];
  return { x, y, left, top, width, height, sx, sy, dx: left - x * sx, dy: top - y * sy };
}

/** A hash of 32 bits. */
function mix(h) {
  h ^= h >>> 16;
  h = Math.imul(h, 0x7feb352d);
  h ^= h >>> 15;
  h = Math.imul(h, 0x846ca68b);
  return h ^ (h >>> 16);
}

export const SIDE = 256; // samples after which noise repeats
export const NOISE_UNITS = [2 * 34.1 * 255, 2 * 29.7 * 255]; // by octave: divides noise to a spread of 0.5 / 255
let white = null; // noise
const tables = [null, null];

/** Add a row of a plane that repeats to a row of sums, shifted and weighted. Rows have functions of their own, which
 * browsers compile sooner than what calls them. */
function addRow(sums, to, plane, row, shift, weight) {
  for (let i = 0; i < SIDE; i++) sums[to + i] += weight * plane[row + ((i + shift) & (SIDE - 1))];
}

/** Sums of neighbours in a plane that repeats, weighted along both axes. */
function filtered(plane, weights) {
  const across = new Int32Array(SIDE * SIDE);
  const sums = new Int32Array(SIDE * SIDE);
  const shift = weights.length >> 1;
  for (let row = 0; row < sums.length; row += SIDE) {
    weights.forEach((weight, k) => addRow(across, row, plane, row, k - shift, weight));
  }
  for (let row = 0; row < sums.length; row += SIDE) {
    weights.forEach((weight, k) => addRow(sums, row, across, (row + (k - shift) * SIDE) & (SIDE * SIDE - 1), 0, weight));
  }
  return sums;
}

function whiteNoise() {
  const noise = new Int32Array(SIDE * SIDE);
  for (let row = 0; row < SIDE; row++) {
    const ofRows = mix(mix(1) + (row >> 2));
    for (let i = 0; i < SIDE; i++) noise[SIDE * row + i] = ((mix(i + ofRows) >>> (8 * (row & 3))) & 255) - 128;
  }
  return noise;
}

/** Noise of an octave, row by row: white noise less its mean around each sample; the finest octave is smoothed. */
export function noiseOf(octave) {
  if (tables[octave]) return tables[octave];
  white ??= whiteNoise();
  const noise = filtered(white, octave ? [1, 2, 1] : [1, 4, 6, 4, 1]);
  for (let i = 0; i < noise.length; i++) noise[i] = (octave ? 16 : 256) * white[i] - noise[i];
  const [smooth, bits] = octave ? [noise, 5] : [filtered(noise, [1, 6, 1]), 14];
  for (let i = 0; i < noise.length; i++) smooth[i] = (smooth[i] + (1 << (bits - 1))) >> bits;
  return (tables[octave] = new Int8Array(smooth));
}

/** The two neighbouring cells of a position, and the fraction between them. */
function between(place, cells) {
  const at = Math.min(Math.max(place / CELL - 0.5, 0), cells - 1);
  const low = Math.floor(at);
  return [low, Math.min(low + 1, cells - 1), at - low];
}

/** Add a row of noise to samples, whose strengths lie between those of two rows. */
function addNoise(samples, at, table, row, left, above, below, share) {
  for (let i = 0; i < above.length; i++, at += 3) {
    const value = table[row + ((left + i) & (SIDE - 1))] * (above[i] * (1 - share) + below[i] * share);
    samples[at] += value;
    samples[at + 1] += value;
    samples[at + 2] += value;
  }
}

/** Add an octave's noise to a level of a view, as strong as its codes say. */
function addTexture({ left, top, width, height, samples }, texture, octave, level, { sx, sy, dx, dy }, gain) {
  const { columns, rows } = texture;
  const strengths = Float64Array.from(texture.octaves[octave], (code) =>
    code === 0 ? 0 : (255 * gain * 2 ** ((code - 1) / 2)) / NOISE_UNITS[octave],
  );
  const side = 2 ** level;
  const table = noiseOf(octave);
  const ofRows = []; // strengths along a row of cells, for each column of samples
  const along = (r) => {
    if (ofRows[r]) return ofRows[r];
    const found = new Float64Array(width);
    for (let i = 0; i < width; i++) {
      const [low, next, share] = between(((left + i + 0.5) * side - dx) / sx, columns);
      found[i] = strengths[r * columns + low] * (1 - share) + strengths[r * columns + next] * share;
    }
    return (ofRows[r] = found);
  };
  for (let j = 0; j < height; j++) {
    const [low, next, share] = between(((top + j + 0.5) * side - dy) / sy, rows);
    addNoise(samples, 3 * width * j, table, SIDE * ((top + j) & (SIDE - 1)), left, along(low), along(next), share);
  }
}

/** The level of a view on which each octave is drawn, and its gain; octaves finer than the view are left out. */
export function octavesOf({ sx, sy }) {
  const n = Math.floor(Math.log2(2 * sx * sy) / 2);
  const gain = n < 0 ? 0.75 : 1;
  const all = Array.from({ length: OCTAVES }, (_, octave) => ({ octave, level: octave + n, gain: octave + n ? 1 : gain }));
  return all.filter(({ level }) => level >= 0);
}

/** The first `count` Gaussians of a file as a picture: { width, height, data }, 8-bit RGBA. Throws SgError. */
export function draw(file, { scale = 1, region = null, count = file.count, texture = true } = {}) {
  const view = viewOf(file, scale, region);
  const octaves = texture && file.texture ? octavesOf(view) : [];
  const top = Math.max(...octaves.map(({ level }) => level), 0);
  const data = drawGaussians(file.values.subarray(0, 8 * count), file.background, view, top, (plane, now) => {
    for (const { octave, level, gain } of octaves) {
      if (level === now) addTexture(plane, file.texture, octave, level, view, gain);
    }
  });
  if (file.alpha) setAlpha(data, draw(file.alpha, { scale, region }).data);
  return { width: view.width, height: view.height, data };
}
