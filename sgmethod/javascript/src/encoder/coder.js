// The entropy coder: docs/format.md, "States and symbols" and "Raw bits and numbers", for short files.

import { MODEL, adapt, bitsAfter, edge } from "../coder.js";

const { floor, min } = Math;

/** Bytes of bits, the first of which is the least significant, or the most. */
export function packed(bits, isFirstMost) {
  const bytes = new Uint8Array((bits.length + 7) >> 3);
  bits.forEach((bit, i) => (bytes[i >> 3] |= bit << (isFirstMost ? 7 - (i & 7) : i & 7)));
  return bytes;
}

/** Collects what is to be coded by models, which adapt; the entropy coder works backwards, so that bytes come at the
 * end. */
export function newWriter(models) {
  const steps = []; // of a symbol, where its share of 32768 begins and how much it is; or [0, 0, bits to be fetched]
  const queue = [];
  const symbol = (found, row, second = row) => {
    const [one, two] = [MODEL * row, MODEL * second];
    const low = edge(models, one + found, two + found);
    steps.push([low, edge(models, one + found + 1, two + found + 1) - low]);
    adapt(models, one, found);
    if (two !== one) adapt(models, two, found);
  };
  const fetch = (count) => steps.push([0, 0, count]);
  const raw = (value, count) => {
    for (let i = 0; i < count; i++) queue.push(floor(value / 2 ** i) & 1);
  };
  const bytes = () => {
    const words = [];
    let state = 65536;
    for (let i = steps.length - 1; i >= 0; i--) {
      const [low, share] = steps[i];
      if (!share) continue;
      if (state >= share * 131072) {
        words[i] = state % 65536;
        state = floor(state / 65536);
      }
      state = floor(state / share) * 32768 + (state % share) + low;
    }
    const out = [state & 255, (state >>> 8) & 255, (state >>> 16) & 255, state >>> 24];
    const rawBytes = packed(queue, false);
    let [left, head] = [0, 0];
    steps.forEach(([, share, count], i) => {
      if (words[i] !== undefined) out.push(words[i] & 255, words[i] >> 8);
      if (share) return;
      for (; left < count; left += 8) out.push(rawBytes[head++]);
      left -= count;
    });
    return out;
  };
  return { symbol, fetch, raw, bytes };
}

/** A number's symbol. */
export function symbolOf(value) {
  const top = 31 - Math.clz32(value);
  return value < 4 ? value : min(2 * top + ((value >> (top - 1)) & 1), 15);
}

/** Write a number, but for the bits behind its symbol; returns how many these are. */
export function begin({ symbol, fetch, raw }, value, one, two) {
  const found = symbolOf(value);
  symbol(found, one, two);
  if (found < 15) return bitsAfter(found);
  const top = 31 - Math.clz32(value);
  fetch(5);
  raw(top, 5);
  fetch(top);
  raw(value, top);
  return 0;
}

/** Write a whole number. */
export function write(writer, value, row) {
  const rest = begin(writer, value, row);
  writer.fetch(rest);
  writer.raw(value, rest);
}
