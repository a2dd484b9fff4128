// Matching pursuit: where another Gaussian lowers the error most.

import { project, subtract } from "./grid.js";

const { floor, max, min, PI, sqrt } = Math;

const BLUR_OF_SCALE = 0.849; // a Gaussian that ends at sigma 3 is as wide as an endless one this much narrower
const GAIN = 4.327 * PI; // of a Gaussian with its best colour: this, times b^2 and the square of the blurred residual
const WIDEST = 1 / 4; // blur, as a part of the longer side

/** Blur lines of `length` samples, `step` apart, by about a Gaussian of scale b: three passes of means; outside, there
 * are zeros. startOf(line): where a line begins. */
function blurred(plane, length, step, lines, startOf, b) {
  const radius = sqrt(b * b + 1 / 4) - 1 / 2; // three means over 2 radius + 1 samples have the variance b^2
  const whole = floor(radius);
  const edge = radius - whole;
  const norm = 1 / (2 * radius + 1);
  const value = (from, i) => (i < 0 || i >= length ? 0 : from[i]);
  let [line, next] = [new Float64Array(length), new Float64Array(length)];
  const out = new Float32Array(plane.length);
  for (let k = 0; k < lines; k++) {
    const start = startOf(k);
    for (let i = 0; i < length; i++) line[i] = plane[start + i * step];
    for (let pass = 0; pass < 3; pass++) {
      let sum = 0;
      for (let i = 0; i < whole; i++) sum += value(line, i);
      for (let i = 0; i < length; i++) {
        sum += value(line, i + whole) - value(line, i - whole - 1);
        next[i] = norm * (sum + edge * (value(line, i + whole + 1) + value(line, i - whole - 1)));
      }
      [line, next] = [next, line];
    }
    for (let i = 0; i < length; i++) out[start + i * step] = line[i];
  }
  return out;
}

/** The gain of a round Gaussian of blur b at every sample. */
function gainsOf({ left, columns, rows }, b) {
  const wide = blurred(left, columns, 3, 3 * rows, (k) => floor(k / 3) * 3 * columns + (k % 3), b);
  const mean = blurred(wide, rows, 3 * columns, 3 * columns, (k) => k, b);
  const [across, down] = [columns, rows].map((n) => blurred(new Float32Array(n).fill(1), n, 1, 1, () => 0, b));
  return Float32Array.from({ length: columns * rows }, (_, i) => {
    const square = mean[3 * i] ** 2 + mean[3 * i + 1] ** 2 + mean[3 * i + 2] ** 2;
    return (GAIN * b * b * square) / (across[i % columns] * down[floor(i / columns)]);
  });
}

/** Whether a sample's value is the largest of those around it. */
function isPeak(plane, columns, rows, at, reach, value) {
  const [x, y] = [at % columns, floor(at / columns)];
  const [left, right] = [max(x - reach, 0), min(x + reach, columns - 1)];
  for (let j = max(y - reach, 0); j <= min(y + reach, rows - 1); j++) {
    for (let i = left; i <= right; i++) if (plane[j * columns + i] > value) return false;
  }
  return true;
}

/** Find at most `most` Gaussians that each lower the squared error by `worth` and more, none narrower than `least`
 * pixels. They are taken off the grid. */
export function found(grid, most, worth, least) {
  const { columns, rows, sx, sy } = grid;
  const scale = sqrt(sx * sy); // samples a pixel
  const sizes = [max(BLUR_OF_SCALE * least * scale, 0.75)];
  while (2 * sizes.at(-1) <= WIDEST * max(columns, rows)) sizes.push(2 * sizes.at(-1));
  const gains = sizes.map((b) => gainsOf(grid, b));
  const highest = gains.reduce((one, other) => one.map((gain, i) => max(gain, other[i])));
  const places = [];
  gains.forEach((of, k) => {
    const reach = max(1, floor(sizes[k]));
    of.forEach((gain, at) => {
      const isHighest = gain > worth && gain === highest[at];
      if (isHighest && isPeak(highest, columns, rows, at, reach, gain)) places.push([gain, at, k]);
    });
  });
  places.sort(([one], [other]) => other - one);
  const gaussians = [];
  for (const [, at, k] of places) {
    if (gaussians.length >= most) break;
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
