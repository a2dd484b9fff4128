// Where the entropy coder's models begin: docs/format.md, "States and symbols".

// Rows as there, but for each ff at their ends.
const ROWS = [
  "10273742515c6f7a8d99a7b3c3ced9", // count
  "41688498b5c8dde8f3f7fbfcfdfe", // distance
  "040d2b5487a7c7d8e7eff6fafdfe", // luma
  "0d214a7badc9e2e7f1f9fd", // a
  "76c0dae8f4f9fdfe",
  "6bc0e1effafd",
  "2f64859dbbcee0e9f2f6fbfdfe",
  "d2f2f9fbfdfe", // b
  "aceaf6fbfe",
  "5ab4dbecf8fcfe",
  "2657748baec4dbe6f2f7fbfd",
  "4d83a9c3d6e3ecf2f6fafcfdfe", // signs of the colour
  "72fcfdfe",
  "8283",
  "478db6",
  "8f8f8f8f",
  "38919191e4",
  "2f2f9898d2d2",
  "26476293b2c8e4",
  "d0fe", // v
  "95e9fc",
  "56a3cce8fc",
  "335f7f9bc5e1fa",
  "203a4d607e98bfdcf8",
  "1b2935415467869fc7e3f9",
  "171d22283440576a8ba4cee4fbfd",
  "101215171e212d3a4d6386a1c2dcf0",
  "d7f5fafcfe", // r
  "a7e8f5fafcfe",
  "5da4c6dbeef5fbfe",
  "3362829ab9cce3edf7fbfd",
  "223b50638196b4c7dde7f3f8fcfe",
  "1927333f5466849bbacddeeaf4f8fc",
  "141b202834425869879fc0d1e3ecf7",
  "181b1e21252a3744596a899db8c9dd",
  "", // signs of the shape
  "7f",
  "8080",
  "57b0d7",
];
// The first row of each model.
export const COUNT = 0;
export const DISTANCE = 1;
export const LUMA = 2;
export const A = 3;
export const B = 7;
export const COLOUR_SIGNS = 11;
export const V = 19;
export const R = 27;
export const SHAPE_SIGNS = 35;

export const SLOW = 17; // where the slow numbers of a model begin, behind 17 fast ones, of which the first is 0
export const SEEN = 34; // where it counts its symbols

const START = ROWS.map((row) => {
  const model = new Int32Array(35);
  for (let i = 1; i < 17; i++) {
    const share = i < 16 ? (32704 * parseInt(row.slice(2 * i - 2, 2 * i) || "ff", 16)) >> 8 : 32704;
    model[i] = model[i + SLOW] = share + 4 * i;
  }
  return model;
});

/** All models: the fast and the slow numbers of each, and what it has seen. */
export const newModels = () => START.map((model) => model.slice());
