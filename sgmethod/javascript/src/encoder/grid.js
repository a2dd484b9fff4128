// A picture as samples of a grid, and Gaussians on it, drawn without the format's coarse levels.
//
// A Gaussian is eight numbers, as readGaussians() gives them: x, y, l1, l2, l3 in pixels of the picture, its colour.

const { ceil, exp, floor, max, min, sqrt } = Math;

const CUTOFF = 3;
const EDGE = exp(-CUTOFF);
// Of the Gaussian that is covered: exp(-sigma) of its samples; four numbers for each of its rows, and how many these
// are; by how much z1 rises from one sample to the next, and z2 falls for that. They are in arrays, and numbers below
// have a line each, because engines make an object of every fraction elsewhere.
let [weights, spans] = [new Float64Array(0), new Float64Array(0)];
let count = 0;
const steps = new Float64Array(2);

/** A grid of samples over a picture of width x height pixels. target: [rows, columns, 3]; left: what Gaussians leave
 * of it. */
export function newGrid(target, columns, rows, width, height) {
  if (weights.length < columns * rows) weights = new Float64Array(columns * rows);
  if (spans.length < 4 * rows) spans = new Float64Array(4 * rows);
  return { target, left: target.slice(), columns, rows, sx: columns / width, sy: rows / height };
}

/** Find the samples that a Gaussian covers. Of a row: where they begin and end among the grid's numbers, z1 of the
 * first, and z2 where z1 is 0. */
function cover({ columns, rows, sx, sy }, g) {
  const [x, y] = [g[0] * sx - 0.5, g[1] * sy - 0.5];
  const [l1, l2, l3] = [g[2] * sx, g[3] * sy, g[4] * sy];
  const slope = l2 / l3;
  const A = 1 + slope * slope;
  const bend = exp(-A / (l1 * l1)); // the ratio of one ratio of neighbours to the next
  const high = sqrt(2 * CUTOFF * (l2 * l2 + l3 * l3));
  const last = min(floor(y + high), rows - 1);
  let n = 0;
  let k = 0;
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
  count = n;
  steps[0] = 1 / l1;
  steps[1] = slope;
}

/** Take a Gaussian off what is left, or put it back with times = -1. */
export function subtract(grid, g, times = 1) {
  cover(grid, g);
  const { left } = grid;
  const [red, green, blue] = [g[5] * times, g[6] * times, g[7] * times];
  for (let row = 0, k = 0; row < count; row += 4) {
    for (let at = spans[row], end = spans[row + 1]; at < end; at += 3) {
      const w = max(weights[k++] - EDGE, 0);
      left[at] -= red * w;
      left[at + 1] -= green * w;
      left[at + 2] -= blue * w;
    }
  }
}

/** Inner products of a Gaussian's weights with what is left, for each colour, and with themselves. */
export function project(grid, g) {
  cover(grid, g);
  const { left } = grid;
  let red = 0;
  let green = 0;
  let blue = 0;
  let energy = 0;
  for (let row = 0, k = 0; row < count; row += 4) {
    for (let at = spans[row], end = spans[row + 1]; at < end; at += 3) {
      const w = max(weights[k++] - EDGE, 0);
      red += left[at] * w;
      green += left[at + 1] * w;
      blue += left[at + 2] * w;
      energy += w * w;
    }
  }
  return [red, green, blue, energy];
}

/** Half the derivative of the squared error by a Gaussian's parameters in its own frame, into `out`: by d, where the
 * mean moves by L d; by S, a lower triangle, where L becomes L (1 + S); and by the colour. */
export function differentiate(grid, g, out) {
  cover(grid, g);
  const { left } = grid;
  const [red, green, blue] = [g[5], g[6], g[7]];
  const [step, slope] = [steps[0], steps[1]];
  out.fill(0);
  for (let row = 0, k = 0; row < count; row += 4) {
    let z = spans[row + 2];
    const e = spans[row + 3];
    let s0 = 0; // sums by powers of z1
    let s1 = 0;
    let s2 = 0;
    for (let at = spans[row], end = spans[row + 1]; at < end; at += 3) {
      const weight = weights[k++];
      const w = max(weight - EDGE, 0);
      out[5] -= left[at] * w;
      out[6] -= left[at + 1] * w;
      out[7] -= left[at + 2] * w;
      const v = (red * left[at] + green * left[at + 1] + blue * left[at + 2]) * weight;
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
  }
}

/** Squared error of what is left. */
export function errorOf({ left }) {
  let sum = 0;
  for (let i = 0; i < left.length; i++) sum += left[i] * left[i];
  return sum;
}

/** Set what is left by Gaussians, each as `g` of an object. */
export function leave(grid, gaussians) {
  grid.left.set(grid.target);
  for (const { g } of gaussians) subtract(grid, g);
}
