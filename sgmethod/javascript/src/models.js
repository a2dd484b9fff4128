// Where the entropy coder's models begin, and the networks of the map: docs/format.md, "States and symbols".
// The label WHOLE: header.js.

import { FLAT, modelsOf, newCoder } from "./coder.js";
import { MAPPED, PACKED } from "./tables.js";

// The first row of each kind of model. Short files have no map, so they know only one row or one block of rows of some
// kinds; what the map adds to these stands behind all others.
export const COUNT = 0;
export const DISTANCE = 1;
export const LUMA = 2;
export const LUMA_BY_GROUP = 3;
export const A = 17;
export const A_BY_GROUP = 21;
export const B = 37;
export const B_BY_LUMA = 41;
export const COLOUR_SIGNS = 57;
export const V = 65;
export const V_BY_GROUP = 73;
export const R = 129;
export const R_BY_DIRECTION = 177;
export const SHAPE_SIGNS = 209;
export const SHORT = 213; // rows of short files
export const MAPPED_LUMA = SHORT;
export const MAPPED_V = 221;
export const MAPPED_R = 293;
export const MAPPED_SIGNS = 581;
const ALL = 681;

// The tables are payloads themselves, as ../tables.mjs writes them.
const starts = [];
const rows = [];
const unpack = (text) => {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const [, number, fetch, , whole] = newCoder(packed, modelsOf(FLAT), true);
  const next = (row) => {
    const found = number(0, row);
    fetch(0);
    return whole(found);
  };
  /** Append numbers, each as its difference from that before it. */
  const append = (numbers, length, row) => {
    while (length--) {
      const found = next(row);
      numbers.push((numbers.at(-1) ?? 0) + (found & 1 ? ~(found >> 1) : found >> 1));
    }
    return numbers;
  };
  for (let count = next(0); count--; ) {
    let left = 256;
    starts.push(FLAT[0].map((_, i) => 256 - (left -= i < 15 ? next(31 - Math.clz32(left)) : left)));
  }
  return append;
};
unpack(PACKED)(rows, SHORT, 9);
/** What src/map.js predicts with. */
export const NET = [];
WHOLE: {
  const append = unpack(MAPPED);
  append(rows, ALL - SHORT, 9);
  append(NET, 147, 10);
}
const START = modelsOf(rows.map((row) => starts[row]));

/** All models: the fast and the slow numbers of each, and what it has seen. */
export const newModels = () => START.slice();
