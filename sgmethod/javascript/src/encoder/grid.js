// A picture as samples of a grid, and Gaussians on it, drawn without the format's coarse levels.
//
// A Gaussian is eight numbers, as readGaussians() gives them: x, y, l1, l2, l3 in pixels of the picture, its colour.

const { ceil, exp, floor, max, min, sqrt } = Math;

const CUTOFF = 3;
const EDGE = exp(-CUTOFF);
// Of the Gaussians that were covered: exp(-sigma) of their samples, and four numbers for each of their rows. Below,
// each number has a declaration of its own, because engines allocate an object for each fraction in an array.
// With | 0, what counts samples stays an integer, which engines index arrays by.
let [weights, spans] = [new Float32Array(0), new Float64Array(0)];
const START = [0, 0, 0, 0];

/** A grid of samples over a picture of width x height pixels. shown: how much an error of each sample counts, 0 to 1;
 * target: [rows, columns, 3], times that; residual: what Gaussians leave of it. low, high: if given, the offsets from
 * the target between which the residual is zero. */
export const newGrid = (target, columns, rows, width, height, { shown, low, high }) => ({
  target,
  shown,
  low,
  high,
  residual: target.slice(),
  columns,
  rows,
  sx: columns / width,
  sy: rows / height,
});

/** An array with room for `more` numbers behind `used`. */
function roomy(array, used, more) {
  if (array.length >= used + more) return array;
  const larger = new array.constructor(2 * (used + more));
  larger.set(array);
  return larger;
}

/** Find the samples that a Gaussian covers. Of a row: where they begin and end among the grid's numbers, z1 of the
 * first, and z2 where z1 is 0. before: what this returned for another Gaussian, which is kept. Returns where those of
 * this one begin and end in spans, and where in weights. */
function cover({ columns, rows, sx, sy }, g, before = START) {
  const [, first, , start] = before;
  weights = roomy(weights, start, columns * rows);
  spans = roomy(spans, first, 4 * rows);
  const [x, y] = [g[0] * sx - 0.5, g[1] * sy - 0.5];
  const [l1, l2, l3] = [g[2] * sx, g[3] * sy, g[4] * sy];
  const slope = l2 / l3;
  const A = 1 + slope * slope;
  const bend = exp(-A / (l1 * l1)); // the ratio of one ratio of neighbours to the next
  const high = sqrt(2 * CUTOFF * (l2 * l2 + l3 * l3));
  const last = min(floor(y + high), rows - 1);
  let n = first;
  let k = start;
  for (let j = max(ceil(y - high), 0); j <= last; j++) {
    const e = (j - y) / l3;
    const half = sqrt(max(2 * CUTOFF * A - e * e, 0));
    const from = max(ceil(x + (l1 * (slope * e - half)) / A), 0);
    const to = min(floor(x + (l1 * (slope * e + half)) / A), columns - 1);
    if (to < from) continue;
    const z1 = (from - x) / l1;
    const z2 = e - slope * z1;
    spans[n] = 3 * (j * columns + from);
    spans[n + 1] = 3 * (j * columns + to + 1);
    spans[n + 2] = z1;
    spans[n + 3] = e;
    n += 4;
    let weight = exp(-(z1 * z1 + z2 * z2) / 2);
    let ratio = exp(-(z1 - slope * z2 + A / (2 * l1)) / l1);
    for (let i = from; i <= to; i++) {
      weights[k++] = weight;
      weight *= ratio;
      ratio *= bend;
    }
  }
  return [first, n, start, k];
}

/** Take a Gaussian off the residual, or put it back with times = -1. Returns what cover() does. */
export function subtract(grid, g, times = 1, before = START) {
  const covered = cover(grid, g, before);
  const { residual, shown } = grid;
  const [red, green, blue] = [g[5] * times, g[6] * times, g[7] * times];
  const [first, last, start] = covered;
  for (let row = first, k = start; row < last; row += 4) {
    for (let at = spans[row] | 0, end = spans[row + 1] | 0, i = (at / 3) | 0; at < end; at += 3) {
      const w = max(weights[k++] - EDGE, 0) * shown[i++];
      residual[at] -= red * w;
      residual[at + 1] -= green * w;
      residual[at + 2] -= blue * w;
    }
  }
  return covered;
}

/** Inner products of a Gaussian's weights with the residual, for each colour, and with themselves. */
export function project(grid, g) {
  const [first, last, start] = cover(grid, g);
  const { residual, shown } = grid;
  let red = 0;
  let green = 0;
  let blue = 0;
  let energy = 0;
  for (let row = first, k = start; row < last; row += 4) {
    for (let at = spans[row] | 0, end = spans[row + 1] | 0, i = (at / 3) | 0; at < end; at += 3) {
      const w = max(weights[k++] - EDGE, 0) * shown[i++];
      red += residual[at] * w;
      green += residual[at + 1] * w;
      blue += residual[at + 2] * w;
      energy += w * w;
    }
  }
  return [red, green, blue, energy];
}

/** Half the derivative of the squared error by a Gaussian's parameters in its own frame, into `out`: by d, where the
 * mean moves by L d; by S, a lower triangle, where L becomes L (1 + S); and by the colour. covered: by
 * setResidual(). */
export function differentiate({ residual, shown, sx }, g, [first, last, start], out) {
  const [red, green, blue] = [g[5], g[6], g[7]];
  const step = 1 / (g[2] * sx); // of z1 from one sample to the next
  const slope = g[3] / g[4]; // by which z2 falls when z1 rises
  out.fill(0);
  for (let row = first, k = start; row < last; row += 4) {
    let z = spans[row + 2];
    const e = spans[row + 3];
    let s0 = 0; // sums by powers of z1
    let s1 = 0;
    let s2 = 0;
    let byRed = 0;
    let byGreen = 0;
    let byBlue = 0;
    for (let at = spans[row] | 0, end = spans[row + 1] | 0, i = (at / 3) | 0; at < end; at += 3) {
      const share = shown[i++];
      const weight = weights[k++];
      const w = max(weight - EDGE, 0) * share;
      byRed += residual[at] * w;
      byGreen += residual[at + 1] * w;
      byBlue += residual[at + 2] * w;
      const v = (red * residual[at] + green * residual[at + 1] + blue * residual[at + 2]) * weight * share;
      s0 += v;
      s1 += v * z;
      s2 += v * z * z;
      z += step;
    }
    out[0] -= s1;
    out[1] -= e * s0 - slope * s1;
    out[2] -= s2;
    out[3] -= e * s1 - slope * s2;
    out[4] -= e * e * s0 - 2 * e * slope * s1 + slope * slope * s2;
    out[5] -= byRed;
    out[6] -= byGreen;
    out[7] -= byBlue;
  }
}

/** Squared error of the residual. */
export function errorOf({ residual }) {
  let sum = 0;
  for (let i = 0; i < residual.length; i++) sum += residual[i] * residual[i];
  return sum;
}

/** Set the residual of Gaussians, each as `g` of an object. Returns for each what cover() does, for differentiate(). */
export function setResidual(grid, gaussians) {
  const { residual, target, low, high } = grid;
  residual.set(target);
  let before = START;
  const covered = gaussians.map(({ g }) => (before = subtract(grid, g, 1, before)));
  if (low) for (let i = 0; i < residual.length; i++) residual[i] += min(max(-residual[i], low[i]), high[i]);
  return covered;
}

/** What Gaussians alone add to a grid; nothing else stays on it. */
export function drawn(grid, gaussians) {
  grid.residual.fill(0);
  for (const { g } of gaussians) subtract(grid, g, -1);
  return grid.residual;
}
