// A search over a file's integers: rounding each Gaussian alone ignores that they overlap. sgmethod/native/refine/.

import { setResidual, project, subtract } from "./grid.js";
import { rounded, withGaussian } from "./integers.js";
import { payloadOf } from "./writing.js";

const { exp, min, sign } = Math;

const SWEEPS = 4;
const BITS_OF_COLOUR = 6; // most bits that another colour is expected to save

/** Change of the squared error if a Gaussian is taken off the residual (times = -2), or put back (2), by its inner
 * products. */
function change(g, products, times) {
  let sum = 0;
  for (let c = 0; c < 3; c++) sum += g[5 + c] * (g[5 + c] * products[3] + times * products[c]);
  return sum;
}

/** These integers, one of them moved. */
function moved(s, name, step, header) {
  const other = { ...s };
  other[name] += step;
  return withGaussian(other, header);
}

/** These integers, and those one step from them. */
function neighbours(s, header) {
  const found = [s];
  const consider = (g) => {
    const other = rounded(g, header, s.spot); // another shape divides the cell differently
    if (other) found.push(other);
  };
  for (const step of [-1, 1]) {
    const grow = exp(step * 0.34657359 * 2 ** -s.uBits);
    const g = s.g.slice();
    for (let i = 2; i < 5; i++) g[i] *= grow;
    consider(g);
    consider(moved(s, "v", step, header).g);
    consider(moved(s, "r", step, header).g);
    if (s.px + step >= 0 && s.px + step < 2 ** s.parts[0]) found.push(moved(s, "px", step, header));
    if (s.py + step >= 0 && s.py + step < 2 ** s.parts[1]) found.push(moved(s, "py", step, header));
  }
  return found;
}

function isSameShape(one, other) {
  for (let i = 0; i < 5; i++) if (one.g[i] !== other.g[i]) return false;
  return true;
}

/** The best integers in place of these, or null if none are worth their bits. The grid is without them. */
function chosen(s, grid, header, price, bitsOf) {
  let [best, least] = [null, 0];
  const consider = (one, products) => {
    const cost = change(one.g, products, -2) + price * bitsOf(one);
    if (cost < least) [best, least] = [one, cost];
    return cost;
  };
  for (const one of neighbours(s, header)) {
    const products = project(grid, one.g);
    const energy = products[3];
    if (!energy) continue;
    const cost = consider(one, products);
    const ideal = one.g.slice();
    for (let c = 0; c < 3; c++) ideal[5 + c] = products[c] / energy;
    const gained = change(one.g, products, -2) - change(ideal, products, -2);
    if (cost - gained - BITS_OF_COLOUR * price >= least) continue; // no other colour can win
    const { y, a, b } = rounded(ideal, header, s.spot) ?? one;
    const coloured = withGaussian({ ...one, y, a, b }, header);
    for (const axis of ["none", "y", "a", "b"]) {
      const smaller = axis === "none" ? coloured : moved(coloured, axis, -sign(coloured[axis]), header);
      const other = rounded(smaller.g, header, s.spot);
      if (other) consider(other, isSameShape(one, other) ? products : project(grid, other.g));
    }
  }
  return best;
}

/** Refine integers to a payload of at most `limit` bytes, and return it with them; the grid then has their residual.
 * price: squared error on the grid that a bit is worth. */
export function refined(all, grid, header, price, limit) {
  let [payload, bitsOf] = payloadOf(all, header);
  const sweep = () => {
    all = all.flatMap((s) => {
      subtract(grid, s.g, -1);
      const best = chosen(s, grid, header, price, bitsOf);
      if (!best) return [];
      subtract(grid, best.g);
      return [best];
    });
    [payload, bitsOf] = payloadOf(all, header);
  };
  const drop = () => {
    while (payload.length > limit) {
      const worths = all.map((s) => change(s.g, project(grid, s.g), 2) / bitsOf(s));
      const least = worths.indexOf(min(...worths));
      subtract(grid, all[least].g, -1);
      all.splice(least, 1);
      [payload, bitsOf] = payloadOf(all, header);
    }
  };
  setResidual(grid, all);
  for (let i = 0; i < SWEEPS; i++) sweep();
  if (payload.length > limit) {
    drop();
    sweep(); // lets the others make up for those dropped
    drop();
  }
  return [payload, all];
}
