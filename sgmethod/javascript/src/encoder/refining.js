// A search over a file's integers: rounding each Gaussian alone ignores that they overlap. sgmethod/native/refine/.

import { leave, project, subtract } from "./grid.js";
import { rounded, withGaussian } from "./integers.js";
import { bitsOf, payloadOf } from "./writing.js";

const { exp, min, sign } = Math;

const SWEEPS = 2;
const BITS_OF_COLOUR = 6; // most bits that another colour is expected to save

/** Change of the squared error if a Gaussian is taken off what is left (times = -2), or put back (2), by its inner
 * products. */
const change = ([, , , , , red, green, blue], [p, q, r, energy], times) =>
  red * (red * energy + times * p) + green * (green * energy + times * q) + blue * (blue * energy + times * r);

/** Integers that are one step from these. */
function neighbours(s, header) {
  const found = [];
  const [x, y, l1, l2, l3, ...colour] = s.g;
  for (const step of [-1, 1]) {
    const grow = exp(step * 0.34657359 * 2 ** -s.uBits);
    found.push(rounded([x, y, l1 * grow, l2 * grow, l3 * grow, ...colour], header));
    for (const name of ["v", "r"]) {
      const { g } = withGaussian({ ...s, [name]: s[name] + step }, header);
      found.push(rounded([x, y, ...g.slice(2)], header)); // another shape divides the cell differently
    }
    ["px", "py"].forEach((name, axis) => {
      const at = s[name] + step;
      if (at >= 0 && at < 2 ** s.parts[axis]) found.push(withGaussian({ ...s, [name]: at }, header));
    });
  }
  return found.filter(Boolean);
}

const isSameShape = (one, other) => one.g.every((value, i) => i >= 5 || value === other.g[i]);

/** The best integers in place of these, or null if none are worth their bits. The grid is without them. */
function chosen(s, grid, header, price, costs) {
  let [best, least] = [null, 0];
  const consider = (one, products) => {
    const cost = change(one.g, products, -2) + price * bitsOf(one, costs, header.grey);
    if (cost < least) [best, least] = [one, cost];
    return cost;
  };
  for (const one of [s, ...neighbours(s, header)]) {
    const products = project(grid, one.g);
    const energy = products[3];
    if (!energy) continue;
    const cost = consider(one, products);
    const ideal = [...one.g.slice(0, 5), products[0] / energy, products[1] / energy, products[2] / energy];
    const gained = change(one.g, products, -2) - change(ideal, products, -2);
    if (cost - gained - BITS_OF_COLOUR * price >= least) continue; // no other colour can win
    const { y, a, b } = rounded(ideal, header) ?? one;
    for (const axis of ["none", "y", "a", "b"]) {
      const colour = { y, a, b };
      if (axis in colour) colour[axis] -= sign(colour[axis]);
      const other = rounded(withGaussian({ ...one, ...colour }, header).g, header);
      if (other) consider(other, isSameShape(one, other) ? products : project(grid, other.g));
    }
  }
  return best;
}

/** Refine integers to a payload of at most `limit` bytes, and return it; the grid is left without them. price: squared
 * error on the grid that a bit is worth. */
export function refined(all, grid, header, price, limit) {
  let [payload, costs] = payloadOf(all, header);
  const sweep = () => {
    all = all.flatMap((s) => {
      subtract(grid, s.g, -1);
      const best = chosen(s, grid, header, price, costs);
      if (!best) return [];
      subtract(grid, best.g);
      return [best];
    });
    [payload, costs] = payloadOf(all, header);
  };
  const drop = () => {
    while (payload.length > limit) {
      const worths = all.map((s) => change(s.g, project(grid, s.g), 2) / bitsOf(s, costs, header.grey));
      const least = worths.indexOf(min(...worths));
      subtract(grid, all[least].g, -1);
      all.splice(least, 1);
      [payload, costs] = payloadOf(all, header);
    }
  };
  leave(grid, all);
  for (let i = 0; i < SWEEPS; i++) sweep();
  if (payload.length > limit) {
    drop();
    sweep(); // lets the others make up for those dropped
    drop();
  }
  return payload;
}
