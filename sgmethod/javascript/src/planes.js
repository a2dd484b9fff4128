// Gaussians to the samples of a pyramid: docs/format.md, "Gaussians to pixels" and "Views".
// The label WHOLE: header.js.

import { ceil, exp, floor, fround, max, min, round, sqrt } from "./header.js";

const CUTOFF = 3;
const EDGE = exp(-CUTOFF);
const KEPT = (1 - EDGE * (1 + CUTOFF + (CUTOFF * CUTOFF) / 2)) / (1 - EDGE * (1 + CUTOFF));
const NARROWEST = 1.4;
const TOP_LEVEL = 12;

/** The nearest integer; the even one of two. */
export const rounded = (x) => (x % 1 === 0.5 ? 2 * round(x / 2) : round(x));

/** Change a Gaussian to what a view shows of it, after the low-pass filter of smaller views, and return the level on which
 * it is drawn. It is then in samples of that level, narrower by what enlarging will widen, and stronger. Above level 0,
 * places count from two samples before the picture. */
function place(g, { sx, sy, dx, dy }) {
  const change = (gain, ...shape) => {
    for (let c = 5; c < 8; c++) g[c] *= gain;
    g.set(shape);
  };
  const a = sx * g[2];
  const d = sy * g[4];
  const [vx, vy] = [sx, sy].map((scale) => max(1 - scale * scale, 0) / (12 * KEPT));
  const wide = sqrt(a * a + vx);
  const b = (sy * g[3]) / wide;
  const high = sqrt(d * d + vy + b * b * vx);
  change((a * d) / (wide * high), g[0] * sx + dx, g[1] * sy + dy, wide, a * b, high);
  const [x, y, l1, l2, l3] = g;
  const xx = l1 * l1;
  const yy = l2 * l2 + l3 * l3;
  const minor = (2 * (xx * l3) * l3) / (xx + yy + sqrt((xx - yy) * (xx - yy) + 4 * (xx * l2) * l2));
  const ratio = minor / (NARROWEST * NARROWEST);
  let level = 0;
  while (level < TOP_LEVEL && 4 ** (level + 1) <= ratio) level++;
  if (level) {
    const s = 2 ** level;
    const v = (1 - 4 ** -level) / 4;
    const [p1, p2, p3] = [l1 / s, l2 / s, l3 / s];
    const [qx, xy, qy] = [p1 * p1 - v, p1 * p2, p2 * p2 + p3 * p3 - v];
    const q1 = sqrt(qx);
    const q3 = sqrt(qx * qy - xy * xy) / q1;
    change(fround((p1 * p3) / (q1 * q3)), x / s + 2, y / s + 2, q1, xy / q1, q3);
  }
  return level;
}

/** The samples of a level, three numbers each, from column `left` and row `top` on. */
function newPlane(left, top, right, bottom) {
  const [width, height] = [right - left, bottom - top];
  return { left, top, width, height, samples: new Float32Array(3 * width * height) };
}

/** The part of the next level that is needed to enlarge a plane. */
const above = ({ left, top, width, height }) =>
  newPlane((left >> 1) - 1, (top >> 1) - 1, ((left + width - 1) >> 1) + 2, ((top + height - 1) >> 1) + 2);

/** Add a Gaussian to the plane of a level. */
function add({ left, top, width, height, samples }, level, g) {
  const [x, y, l1, l2, l3, red, green, blue] = g;
  const first = level ? 2.5 : 0.5; // where the centre of sample 0 lies
  const slope = l2 / l3;
  const A = 1 + slope * slope;
  const high = sqrt(2 * CUTOFF * (l2 * l2 + l3 * l3));
  const centre = x - first - left;
  const end = min(floor(y + high - first) - top, height - 1);
  const bend = exp(-A / (l1 * l1)); // the ratio of one ratio of neighbours to the next
  for (let j = max(ceil(y - high - first) - top, 0); j <= end; j++) {
    const e = (j + top + first - y) / l3;
    const half = sqrt(2 * CUTOFF * A - e * e); // NaN beyond
    const from = max(ceil(centre + (l1 * (slope * e - half)) / A), 0);
    const to = min(floor(centre + (l1 * (slope * e + half)) / A), width - 1);
    const z1 = (from - centre) / l1;
    const z2 = e - slope * z1;
    let weight = exp(-(z1 * z1 + z2 * z2) / 2);
    let ratio = exp(-(z1 - slope * z2 + A / (2 * l1)) / l1);
    for (let i = from, at = 3 * (j * width + from); i <= to; i++, at += 3) {
      const w = 255 * max(weight - EDGE, 0);
      samples[at] += red * w;
      samples[at + 1] += green * w;
      samples[at + 2] += blue * w;
      weight *= ratio;
      ratio *= bend;
    }
  }
}

/** Write the sum of a plane and the next level, enlarged by two, into `out`, `stride` numbers for a sample. */
function addEnlarged({ left, top, width, height, samples }, coarse, out, stride) {
  const above = coarse.samples;
  const row = new Float32Array(3 * coarse.width);
  for (let j = top, at = 0, to = 0; j < top + height; j++) {
    const near = ((j >> 1) - coarse.top) * row.length;
    const far = near + (j & 1 ? row.length : -row.length);
    for (let i = 0; i < row.length; i++) row[i] = 0.75 * above[near + i] + 0.25 * above[far + i];
    for (let i = left; i < left + width; i++, at += 3, to += stride) {
      const one = 3 * ((i >> 1) - coarse.left);
      const other = one + (i & 1 ? 3 : -3);
      out[to] = samples[at] + 0.75 * row[one] + 0.25 * row[other];
      out[to + 1] = samples[at + 1] + 0.75 * row[one + 1] + 0.25 * row[other + 1];
      out[to + 2] = samples[at + 2] + 0.75 * row[one + 2] + 0.25 * row[other + 2];
    }
  }
}

/** Draw Gaussians, of which each is eight numbers, in a view, on a background: 8-bit RGBA, row by row.
 * addTo(plane, level) adds what else there is on a level, up to `highest`; samples are in levels of 8 bits. */
export function drawGaussians(gaussians, background, view, highest = 0, addTo) {
  const drawn = []; // by level
  for (let at = 0; at < gaussians.length; at += 8) {
    const g = gaussians.slice(at, at + 8);
    (drawn[place(g, view)] ??= []).push(g);
  }
  const { left, top, width, height } = view;
  const data = new Uint8ClampedArray(4 * width * height).fill(255);
  const planes = [newPlane(left, top, left + width, top + height)];
  while (planes.length < max(highest + 2, drawn.length + 1)) planes.push(above(planes.at(-1)));
  let coarse = planes.pop(); // above all that is drawn: the background
  coarse.samples.forEach((_, i, samples) => (samples[i] = background[i % 3]));
  for (let plane; (plane = planes.pop()); coarse = plane) {
    const level = planes.length;
    drawn[level]?.forEach((g) => add(plane, level, g));
    WHOLE: addTo?.(plane, level);
    addEnlarged(plane, coarse, level ? plane.samples : data, level ? 3 : 4);
  }
  return data;
}

/** Take a picture's alpha from a grey picture. */
export function setAlpha(data, grey) {
  for (let at = 3; at < data.length; at += 4) data[at] = grey[at - 1];
}
