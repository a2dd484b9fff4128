// A picture reduced to what a preview can show.

import { bytesOf } from "../header.js";
import { SHORTEST, THINNEST } from "./settings.js";

const { abs, floor, max, min, round, sqrt } = Math;

/** Size of about this many pixels at most, with the nearest aspect ratio: sgmethod/previews/reducing.py. */
export function reducedSize(width, height, pixels) {
  const [short, long] = [min(width, height), max(width, height)];
  const longest = floor(pixels / THINNEST);
  const scale = min(sqrt(pixels / (short * long)), longest / long);
  if (scale >= 1) return [width, height];
  const maxSide = max(floor(scale * short), 1);
  let best = [1, longest];
  let least = Infinity;
  for (let side = maxSide; side > floor(SHORTEST * maxSide); side--) {
    const other = min(round((side * long) / short), longest);
    const off = abs(((other / side) * short) / long - 1);
    if (off < least) [best, least] = [[side, other], off];
  }
  return width < height ? best : best.reverse();
}

/** A picture of 8-bit RGBA, as averaged() takes it. Throws TypeError. */
export function pictureOf(given, width, height) {
  const rgba = bytesOf(given?.data ?? given, "rgba");
  if ((given.colorSpace ?? "srgb") !== "srgb") {
    throw new TypeError(`rgba must be in sRGB, not ${given.colorSpace}: give getImageData() { colorSpace: "srgb" }`);
  }
  if (!(Number.isInteger(width) && Number.isInteger(height) && width >= 1 && height >= 1)) {
    throw new TypeError(`width and height must be whole numbers from 1 on, not ${width} and ${height}`);
  }
  const expected = 4 * width * height;
  if (rgba.length !== expected) {
    throw new TypeError(
      `rgba of ${width} x ${height} pixels must have ${expected} bytes, 4 a pixel, not ${rgba.length}`,
    );
  }
  return { rgba, columns: width, rows: height };
}

/** Where each of `from` pixels falls on `to` samples: the sample, and the part of the pixel that is in it, not in the
 * next. */
function shares(from, to) {
  const scale = to / from;
  const first = Int32Array.from({ length: from }, (_, i) => min(floor(i * scale + 1e-9), to - 1));
  return [first, Float64Array.from(first, (at, i) => min((at + 1 - i * scale) / scale, 1))];
}

/** A picture's means over columns x rows samples: four numbers each, 0 to 1, the colour multiplied by alpha. The
 * picture is pictureOf()'s, or what this returned. */
export function averaged(picture, columns, rows) {
  const [across, acrossShares] = shares(picture.columns, columns);
  const [down, downShares] = shares(picture.rows, rows);
  const [row, line] = [new Float32Array(4 * picture.columns), new Float32Array(4 * columns + 4)];
  const means = new Float32Array(4 * columns * (rows + 1)); // the last row stays empty
  const scale = (columns * rows) / (picture.columns * picture.rows);
  for (let y = 0; y < picture.rows; y++) {
    read(picture, y, row);
    gather(row, across, acrossShares, line);
    const upper = scale * downShares[y];
    const lower = scale - upper;
    for (let i = 0, to = 4 * columns * down[y]; i < 4 * columns; i++, to++) {
      means[to] += upper * line[i];
      means[to + 4 * columns] += lower * line[i];
    }
  }
  return { means: means.subarray(0, 4 * columns * rows), columns, rows };
}

/** Sum a row's pixels by sample. */
function gather(row, first, shares, line) {
  line.fill(0);
  for (let x = 0; x < first.length; x++) {
    const share = shares[x];
    const to = 4 * first[x];
    for (let c = 0; c < 4; c++) line[to + c] += share * row[4 * x + c];
    if (share < 1) for (let c = 0; c < 4; c++) line[to + 4 + c] += (1 - share) * row[4 * x + c];
  }
}

/** Read a row of a picture. */
function read({ rgba, means, columns }, y, row) {
  if (means) return row.set(means.subarray(4 * y * columns, 4 * (y + 1) * columns));
  for (let to = 0, at = 4 * y * columns; to < 4 * columns; to += 4, at += 4) {
    const alpha = rgba[at + 3] / 65025;
    row[to] = rgba[at] * alpha;
    row[to + 1] = rgba[at + 1] * alpha;
    row[to + 2] = rgba[at + 2] * alpha;
    row[to + 3] = 255 * alpha;
  }
}
