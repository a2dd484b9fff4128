// Matching pursuit: where another Gaussian lowers the error most.

import { project, subtract } from "./grid.js";

const { floor, max, min, PI, sqrt } = Math;

const BLUR_OF_SCALE = 0.849; // a Gaussian that ends at sigma 3 is as wide as an endless one this much narrower
const GAIN = 4.327 * PI; // of a Gaussian with its best colour: this, times b^2 and the square of the blurred residual
const WIDEST = 1 / 4; // blur, as a part of the longer side

/** Blur a plane along lines of `length` samples, `step` numbers apart, by about a Gaussian of scale b: three passes of
 * means; outside, there are zeros. */
function blurred(plane, length, step, b) {
  const radius = sqrt(b * b + 1 / 4) - 1 / 2; // three means over 2 radius + 1 samples have the variance b^2
  const whole = floor(radius);
  const edge = radius - whole;
  const norm = 1 / (2 * radius + 1);
  const margin = whole + 1;
  const reach = min(whole, length); // all beyond is zero
  let line = new Float64Array(length + 2 * margin);
  let next = new Float64Array(length + 2 * margin);
  const out = new Float32Array(plane.length);
  for (let k = 0; k < plane.length / length; k++) {
    const start = floor(k / step) * step * length + (k % step);
    for (let i = 0; i < length; i++) line[margin + i] = plane[start + i * step];
    for (let pass = 0; pass < 3; pass++) {
      let sum = 0;
      for (let i = margin; i < margin + reach; i++) sum += line[i];
      for (let i = margin; i < margin + length; i++) {
        sum += line[i + whole] - line[i - margin];
        next[i] = norm * (sum + edge * (line[i + margin] + line[i - margin]));
      }
      [line, next] = [next, line];
    }
    for (let i = 0; i < length; i++) out[start + i * step] = line[margin + i];
  }
  return out;
}

/** The gain of a round Gaussian of blur b at every sample. */
function gainsOf({ residual, columns, rows }, b) {
  const mean = blurred(blurred(residual, columns, 3, b), rows, 3 * columns, b);
  const [across, down] = [columns, rows].map((n) => blurred(new Float32Array(n).fill(1), n, 1, b));
  const gains = new Float32Array(columns * rows);
  for (let at = 0, i = 0; at < gains.length; at++, i += 3) {
    const square = mean[i] * mean[i] + mean[i + 1] * mean[i + 1] + mean[i + 2] * mean[i + 2];
    gains[at] = (GAIN * b * b * square) / (across[at % columns] * down[floor(at / columns)]);
  }
  return gains;
}

/** Whether a sample's value is the largest of those around it. */
function isPeak(plane, columns, rows, at, reach) {
  const [x, y] = [at % columns, floor(at / columns)];
  const [left, right] = [max(x - reach, 0), min(x + reach, columns - 1)];
  for (let j = max(y - reach, 0); j <= min(y + reach, rows - 1); j++) {
    for (let i = left; i <= right; i++) if (plane[j * columns + i] > plane[at]) return false;
  }
  return true;
}

/** Append the places where a size gains most of all, and more than `worth`: gain, sample, size. */
function addPeaks(places, gains, highest, { columns, rows }, worth, b, size) {
  for (let at = 0; at < gains.length; at++) {
    if (gains[at] <= worth || gains[at] < highest[at]) continue;
    if (isPeak(highest, columns, rows, at, max(1, floor(b)))) places.push([gains[at], at, size]);
  }
}

function raise(highest, gains) {
  for (let at = 0; at < gains.length; at++) highest[at] = max(highest[at], gains[at]);
}

/** Find at most `limit` Gaussians that each lower the squared error by `worth` and more, none narrower than `least`
 * pixels. They are taken off the grid. */
export function found(grid, limit, worth, least) {
  const { columns, rows, sx, sy } = grid;
  const scale = sqrt(sx * sy); // samples a pixel
  const sizes = [max(BLUR_OF_SCALE * least * scale, 0.75)];
  while (2 * sizes.at(-1) <= WIDEST * max(columns, rows)) sizes.push(2 * sizes.at(-1));
  const gains = sizes.map((b) => gainsOf(grid, b));
  const highest = new Float32Array(columns * rows);
  for (const of of gains) raise(highest, of);
  const places = [];
  sizes.forEach((b, k) => addPeaks(places, gains[k], highest, grid, worth, b, k));
  places.sort(([one], [other]) => other - one);
  const gaussians = [];
  for (const [, at, k] of places) {
    if (gaussians.length >= limit) break;
    const s = max(sizes[k] / BLUR_OF_SCALE / scale, least);
    const g = Float64Array.of(((at % columns) + 0.5) / sx, (floor(at / columns) + 0.5) / sy, s, 0, s, 0, 0, 0);
    const [red, green, blue, energy] = project(grid, g);
    if (red * red + green * green + blue * blue < worth * energy) continue;
    g.set([red / energy, green / energy, blue / energy], 5);
    subtract(grid, g);
    gaussians.push(g);
  }
  return gaussians;
}
