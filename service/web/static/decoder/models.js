// Where the entropy coder's models begin: docs/format.md, "Models".

const ROWS = {
  count: ["10273742515c6f7a8d99a7b3c3ced9"],
  distance: ["41688498b5c8dde8f3f7fbfcfdfeff"],
  luma: ["040d2b5487a7c7d8e7eff6fafdfeff"],
  a: [
    "0d214a7badc9e2e7f1f9fdffffffff",
    "76c0dae8f4f9fdfeffffffffffffff",
    "6bc0e1effafdffffffffffffffffff",
    "2f64859dbbcee0e9f2f6fbfdfeffff",
  ],
  b: [
    "d2f2f9fbfdfeffffffffffffffffff",
    "aceaf6fbfeffffffffffffffffffff",
    "5ab4dbecf8fcfeffffffffffffffff",
    "2657748baec4dbe6f2f7fbfdffffff",
  ],
  colourSigns: [
    "4d83a9c3d6e3ecf2f6fafcfdfeffff",
    "72fcfdfeffffffffffffffffffffff",
    "8283ffffffffffffffffffffffffff",
    "478db6ffffffffffffffffffffffff",
    "8f8f8f8fffffffffffffffffffffff",
    "38919191e4ffffffffffffffffffff",
    "2f2f9898d2d2ffffffffffffffffff",
    "26476293b2c8e4ffffffffffffffff",
  ],
  v: [
    "d0feffffffffffffffffffffffffff",
    "95e9fcffffffffffffffffffffffff",
    "56a3cce8fcffffffffffffffffffff",
    "335f7f9bc5e1faffffffffffffffff",
    "203a4d607e98bfdcf8ffffffffffff",
    "1b2935415467869fc7e3f9ffffffff",
    "171d22283440576a8ba4cee4fbfdff",
    "101215171e212d3a4d6386a1c2dcf0",
  ],
  r: [
    "d7f5fafcfeffffffffffffffffffff",
    "a7e8f5fafcfeffffffffffffffffff",
    "5da4c6dbeef5fbfeffffffffffffff",
    "3362829ab9cce3edf7fbfdffffffff",
    "223b50638196b4c7dde7f3f8fcfeff",
    "1927333f5466849bbacddeeaf4f8fc",
    "141b202834425869879fc0d1e3ecf7",
    "181b1e21252a3744596a899db8c9dd",
  ],
  shapeSigns: [
    "ffffffffffffffffffffffffffffff",
    "7fffffffffffffffffffffffffffff",
    "8080ffffffffffffffffffffffffff",
    "57b0d7ffffffffffffffffffffffff",
  ],
};

/** An adaptive model of a symbol, 0 to 15. */
class Model {
  constructor(row) {
    this.fast = new Int32Array(17);
    for (let i = 1; i < 16; i++) {
      const byte = parseInt(row.slice(2 * i - 2, 2 * i), 16);
      this.fast[i] = ((32704 * byte) >> 8) + 4 * i;
    }
    this.slow = this.fast.slice();
    this.seen = 0;
  }

  /** Where the share of symbol i begins, in 1/32768. */
  edge(i) {
    return i === 16 ? 32768 : (this.fast[i] + this.slow[i]) >> 1;
  }

  adapt(symbol) {
    const { fast, slow } = this;
    const j = this.seen < 112 ? 31 - Math.clz32(this.seen + 16) : 7;
    const half = (1 << (j - 1)) - 1;
    this.seen++;
    for (let i = 1; i < 16; i++) {
      const aim = i > symbol ? 4 * i + 32704 : 4 * i;
      fast[i] += (aim - fast[i] + 15) >> 5;
      slow[i] += (aim - slow[i] + half) >> j;
    }
  }
}

/** All models of a file, by name. */
export const newModels = () =>
  Object.fromEntries(Object.entries(ROWS).map(([name, rows]) => [name, rows.map((row) => new Model(row))]));
