// Gaussians fitted to a picture within a number of bytes: profile rd (sgmethod/rd/encode.py) in fewer steps, and for
// squared error only. Constants here, unlike those in settings.js, were chosen on 24 photographs at 64, 200 and 1,000
// bytes: docs/notebook/service.md.

import { found } from "./growing.js";
import { differentiate, errorOf, setResidual } from "./grid.js";
import { FINEST, codeOf, quantumOf, rounded } from "./integers.js";
import { refined } from "./refining.js";
import { BETA1, BETA2, BITS_OF_NEW, BITS_PER_GAUSSIAN, DENSE, EXCESS, EXCESS_FROM } from "./settings.js";
import { EXCESS_UNTIL, FAINT, FINER_EARLY, LAST_RATE, MIN_GROWN, MIN_USED, NEWTON_STEPS } from "./settings.js";
import { QUANTUM_PER_SIZE, RATE, RATE_WEIGHT, REACH, REFINE_WEIGHT, SPARSE, STEERING_EXPONENT } from "./settings.js";
import { STEERING_FROM, STEERING_LIMIT, WORTHLESS_BITS } from "./settings.js";
import { payloadOf } from "./writing.js";

const { abs, cos, exp, floor, log, max, min, PI, round, sign, sqrt } = Math;

const [STEPS, DENSE_STEPS] = [150, 4]; // and a factor on the steps of dense Gaussians
// Of a picture, as most steps see it, and the last ones and the search for integers: at most so many samples for each
// Gaussian expected, and so many along the least l1.
export const COARSE = [100, 2.5];
export const FINE = [400, 5];
const FINE_FROM = 0.75; // parts of the steps, as all times are
const MAX_SURPLUS = 3; // Gaussians while they grow, in multiples of those expected
const BITS_OF_DROPPED = 14;
const GROWTH_AT = [0, 0.06, 0.12, 0.18, 0.24, 0.3, 0.37, 0.45, 0.55, 0.65];
const TRIM_AT = [0.72, 0.78, 0.82, 0.86, 0.9, 0.94, 0.97];
const CURVATURE = [1 / 2, 1 / 2, 3 / 4, 1 / 4, 3 / 4, 1, 1, 1];
const TRIES = 4;

/** About how many Gaussians a payload holds. */
export const expectedIn = (bytes) => max(floor((8 * bytes) / BITS_PER_GAUSSIAN), 1);

/** A first guess of the quantum that takes these bytes. */
export function quantumIn(bytes, { width, height }) {
  const [pixels, bits] = [width * height, 8 * max(bytes, 1)];
  const seen = min(pixels, (100 * bits) / BITS_PER_GAUSSIAN); // pixels that so many bits can show
  return 0.15 * ((0.25 * seen) / bits) ** 1.1 * sqrt(pixels / seen);
}

/** Squared error that a bit is worth. */
const priceOf = (quantum) => (quantum * quantum * Math.LN2) / 6;

/** Add the derivative of an estimate of a Gaussian's bits, times `weight`, to what differentiate() finds. */
function addRate(g, quantum, weight, out) {
  const [l1, l2, l3, red, green, blue] = [g[2], g[3], g[4], g[5], g[6], g[7]];
  const perStep = (1.5 * sqrt(l1 * l3)) / quantum;
  const [i, j, k] = [perStep / sqrt(3), perStep / sqrt(2), perStep / sqrt(6)];
  const [p, q, s] = [(red + green + blue) * i, (red - blue) * j, (red - 2 * green + blue) * k];
  const m = sqrt(p * p + q * q + s * s + 1e-12);
  const [v, r] = [log(l1 / l3) / 2, l2 / l3];
  const byV = 1 / (1 + abs(v) * m);
  const byR = 0.5 / (1 + (abs(r) * m) / 2);
  const byM = abs(v) * byV + abs(r) * byR + 3 / (1 + m);
  const y = sign(p) / (1 + abs(p)) + (byM * p) / m;
  const a = sign(q) / (1 + abs(q)) + (byM * q) / m;
  const b = sign(s) / (1 + abs(s)) + (byM * s) / m;
  const bySize = (y * p + a * q + b * s) / 2;
  const [dv, dr] = [(sign(v) * m * byV) / 2, sign(r) * m * byR];
  out[2] += weight * (bySize + dv + dr * r);
  out[3] += weight * dr;
  out[4] += weight * (bySize - dv - dr * r);
  out[5] += weight * (y * i + a * j + b * k);
  out[6] += weight * (y * i - 2 * b * k);
  out[7] += weight * (y * i - a * j + b * k);
}

/** One step of Adam for a Gaussian in its own frame, at most NEWTON_STEPS of Gauss-Newton's. d: the derivative, which
 * becomes the step; area: samples a pixel; least: pixels of l1 and l3. */
function move({ g, first, second, age }, d, rate, area, least) {
  const [unbias1, unbias2] = [1 / (1 - BETA1 ** age), 1 / (1 - BETA2 ** age)];
  const size = PI * g[2] * g[4] * area;
  const square = max(g[5] ** 2 + g[6] ** 2 + g[7] ** 2, FAINT ** 2);
  for (let i = 0; i < 8; i++) {
    first[i] += (1 - BETA1) * (d[i] - first[i]);
    second[i] += (1 - BETA2) * (d[i] * d[i] - second[i]);
    const adam = rate / (sqrt(second[i] * unbias2) + 1e-15);
    const newton = NEWTON_STEPS / (size * CURVATURE[i] * (i < 5 ? square : 1));
    d[i] = -min(adam, newton) * first[i] * unbias1;
  }
  g[0] += g[2] * d[0];
  g[1] += g[3] * d[0] + g[4] * d[1];
  const grow = exp(d[2]);
  g[2] = max(g[2] * grow, least);
  g[3] = g[3] * grow + g[4] * d[3];
  g[4] = max(g[4] * exp(d[4]), least);
  for (let i = 5; i < 8; i++) g[i] += d[i];
}

/** Move all Gaussians by one step down the error on a grid and the price of their bits. */
function descend(all, grid, { width, height }, quantum, rate, least) {
  const area = grid.sx * grid.sy;
  const weight = (RATE_WEIGHT * priceOf(quantum) * area) / (2 * Math.LN2);
  const d = new Float64Array(8);
  const covered = setResidual(grid, all);
  all.forEach((one, i) => {
    const { g } = one;
    differentiate(grid, g, covered[i], d);
    addRate(g, quantum, weight, d);
    one.age++;
    move(one, d, rate, area, least);
    const margin = REACH * sqrt(g[2] * g[4]);
    g[0] = min(max(g[0], -margin), width + margin);
    g[1] = min(max(g[1], -margin), height + margin);
  });
}

/** Drop the Gaussians whose energy is not worth this many bits. */
function pruned(all, bits, quantum) {
  const worth = (bits * priceOf(quantum)) / PI;
  return all.filter(({ g }) => g[2] * g[4] * (g[5] ** 2 + g[6] ** 2 + g[7] ** 2) > worth);
}

/** A header with this quantum, and what the Gaussians' integers are by it. */
function coded(all, header, quantum) {
  const own = { ...header, quantum };
  return [own, all.map(({ g }) => rounded(g, own)).filter(Boolean)];
}

const sizeOf = ([header, symbols]) => payloadOf(symbols, header)[0].length;

/** The quantum that brings a payload of `size` bytes nearer to the limit, or to the surplus allowed at a time; in the
 * end at least `finest`. */
function steered(quantum, size, limit, finest, at) {
  const surplus = 1 - min(max((at - EXCESS_FROM) / (EXCESS_UNTIL - EXCESS_FROM), 0), 1);
  const ratio = (size / (limit * (1 + EXCESS * surplus))) ** STEERING_EXPONENT;
  return max(quantum * min(max(ratio, 1 / STEERING_LIMIT), STEERING_LIMIT), finest / FINER_EARLY ** surplus);
}

/** Code Gaussians with several quanta, at least `finest`, refine each, and return the header of the best with its
 * payload, and its integers. */
function searched(all, grid, header, limit, finest, quantum) {
  const at = (n) => coded(all, { ...header, code: codeOf(n) }, quantumOf(n));
  const finer = (n, least) => {
    while (n < FINEST && quantumOf(n) > least) n++;
    return n;
  };
  const end = finer(0, finest);
  let n = min(finer(0, quantum), end);
  while (n > 0 && sizeOf(at(n)) > limit) n--;
  while (n < end && sizeOf(at(n + 1)) <= limit) n++;
  let [best, least] = [null, Infinity];
  for (let i = 0; i < TRIES; i++) {
    const [own, symbols] = at(n);
    const price = REFINE_WEIGHT * priceOf(own.quantum) * grid.sx * grid.sy;
    const [payload, integers] = refined(symbols, grid, own, price, limit);
    const error = errorOf(grid);
    if (error < least) [best, least] = [[{ ...own, payload }, integers], error];
    const used = payload.length / limit;
    if (!used || used >= MIN_USED || n === end) break;
    n = min(finer(n + 1, own.quantum * used ** QUANTUM_PER_SIZE), end);
  }
  return best;
}

/** Fit Gaussians to a picture, given as two grids. header: has width, height and grey; limit: bytes of the payload;
 * least: pixels of l1 and l3; finest: quantum, so that what needs few bytes takes no more. Returns the header with the
 * code of the quantum and the payload; and the integers. */
export function fitted([coarse, fine], header, limit, least, finest = 0) {
  const expected = expectedIn(limit);
  const pixels = header.width * header.height; // and Gaussians that a file may have
  const density = min(max((expected / pixels - SPARSE) / (DENSE - SPARSE), 0), 1);
  const steps = round(STEPS * (1 + density * (DENSE_STEPS - 1)));
  let quantum = max(quantumIn(limit, header), finest / FINER_EARLY);
  let all = [];
  for (let step = 0; step < steps; step++) {
    const at = step / steps;
    const isNow = (time) => round(time * steps) === step;
    const grid = at < FINE_FROM ? coarse : fine;
    const grows = GROWTH_AT.some(isNow);
    if (grows || TRIM_AT.some(isNow)) {
      all = pruned(all, at < GROWTH_AT.at(-1) ? WORTHLESS_BITS : BITS_OF_DROPPED, quantum);
      if (at >= STEERING_FROM) quantum = steered(quantum, sizeOf(coded(all, header, quantum)), limit, finest, at);
    }
    if (grows) {
      setResidual(grid, all);
      const more = max(all.length, floor(expected / GROWTH_AT.length), MIN_GROWN);
      const maxNew = min(more, min(MAX_SURPLUS * expected, pixels) - all.length);
      const worth = RATE_WEIGHT * BITS_OF_NEW * priceOf(quantum) * grid.sx * grid.sy;
      for (const g of found(grid, maxNew, worth, least)) {
        all.push({ g, first: new Float64Array(8), second: new Float64Array(8), age: 0 });
      }
    }
    descend(all, grid, header, quantum, RATE * (LAST_RATE + ((1 - LAST_RATE) * (1 + cos(PI * at))) / 2), least);
  }
  return searched(all, fine, header, limit, finest, quantum);
}
