// Where the entropy coder's models begin, and the networks of the map: docs/format.md, "States and symbols".

import { FLAT, modelsOf, newCoder } from "./coder.js";
import { PACKED } from "./tables.js";

// The first row of each kind of model.
export const COUNT = 0;
export const DISTANCE = 1;
export const LUMA = 2;
export const LUMA_BY_GROUP = 11;
export const A = 25;
export const A_BY_GROUP = 29;
export const B = 45;
export const B_BY_LUMA = 49;
export const COLOUR_SIGNS = 65;
export const V = 73;
export const V_BY_GROUP = 153;
export const R = 209;
export const R_BY_DIRECTION = 257;
export const SHAPE_SIGNS = 577;
export const END = 681;

// The tables are a payload themselves, as ../tables.mjs writes it.
const packed = Uint8Array.from(atob(PACKED), (letter) => letter.charCodeAt(0));
const [, number, fetch, , whole] = newCoder(packed, modelsOf(FLAT), true);
const next = (row) => {
  const found = number(0, row);
  fetch(0);
  return whole(found);
};
/** Numbers, each as its difference from that `back` before it. */
const list = (length, row, back) => {
  const numbers = [];
  for (let i = 0; i < length; i++) {
    const found = next(row);
    numbers[i] = (numbers[i - back(i)] ?? 0) + (found & 1 ? ~(found >> 1) : found >> 1);
  }
  return numbers;
};
const starts = Array.from({ length: next(0) }, () => {
  let left = 256;
  return FLAT[0].map((_, i) => 256 - (left -= i < 15 ? next(31 - Math.clz32(left)) : left));
});
const rows = list(END, 9, (i) => (i >= R_BY_DIRECTION && i < SHAPE_SIGNS ? 4 : 1));
const START = modelsOf(rows.map((row) => starts[row]));

/** What src/map.js predicts with. */
export const NET = list(147, 10, () => 1);

/** All models: the fast and the slow numbers of each, and what it has seen. */
export const newModels = () => START.slice();
