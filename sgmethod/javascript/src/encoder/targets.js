// What Gaussians are to add to a background on a grid: alpha, and then colours, as in sgmethod/rd/alpha.py.

import { drawn, newGrid } from "./grid.js";
import { levelOf } from "./integers.js";
import { MARGIN, OF_SLOPE, OVERSHOOT } from "./settings.js";

const { abs, floor, max, min } = Math;

export const MIN_VISIBLE_CHANGE = 1 / 512; // half a level of 8 bits
const HIDDEN = 1 / 64; // weight of the average where alpha hides a colour

/** A grid for the colours of a picture that is averaged(). An error of a colour counts as much as the alpha that is
 * decoded lets it be seen; shown: that alpha, if there is any. What alpha hides counts as average. */
export function ofColours({ means, columns, rows }, { width, height, background }, average, shown) {
  shown ??= new Float32Array(columns * rows).fill(1);
  const target = new Float32Array(3 * columns * rows);
  shown.forEach((share, i) => {
    const alpha = means[4 * i + 3];
    const hidden = HIDDEN * (1 - alpha);
    for (let c = 0; c < 3; c++) {
      const colour = (means[4 * i + c] + hidden * average[c]) / (alpha + hidden);
      target[3 * i + c] = share * (colour - levelOf(background[c]));
    }
  });
  return newGrid(target, columns, rows, width, height, { shown });
}

/** A grid for a picture's alpha. Decoding clamps it, so that it may lie beyond 0 and 1, and at steep edges must. */
export function ofAlpha({ means, columns, rows }, { width, height, background }) {
  const alpha = means.filter((_, i) => i % 4 === 3);
  const [target, low, high] = [0, 1, 2].map(() => new Float32Array(3 * alpha.length));
  alpha.forEach((level, i) => {
    const [isClear, isOpaque] = [level < MIN_VISIBLE_CHANGE, level > 1 - MIN_VISIBLE_CHANGE];
    const margin = isClear || isOpaque ? MARGIN + OF_SLOPE * slopeAt(alpha, columns, rows, i) : 0;
    for (let at = 3 * i; at < 3 * i + 3; at++) {
      target[at] = level - levelOf(background[0]);
      low[at] = isClear ? -OVERSHOOT : margin;
      high[at] = isOpaque ? OVERSHOOT : -margin;
    }
  });
  const shown = new Float32Array(alpha.length).fill(1);
  return newGrid(target, columns, rows, width, height, { shown, low, high });
}

/** Half of the largest difference of a sample from those around it. */
function slopeAt(plane, columns, rows, at) {
  const [x, y] = [at % columns, floor(at / columns)];
  let largest = 0;
  for (let j = max(y - 1, 0); j <= min(y + 1, rows - 1); j++) {
    for (let i = max(x - 1, 0); i <= min(x + 1, columns - 1); i++)
      largest = max(largest, abs(plane[j * columns + i] - plane[at]));
  }
  return largest / 2;
}

/** The alpha that is decoded from Gaussians on a background, on ofAlpha()'s grid. */
export const decodedAlpha = (grid, gaussians, { background }) =>
  drawn(grid, gaussians)
    .filter((_, i) => i % 3 === 0)
    .map((value) => min(max(levelOf(background[0]) + value, 0), 1));
