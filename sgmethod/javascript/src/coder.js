// The entropy decoder of version 2: docs/format.md, "States and symbols" and "Raw bits and numbers".
// The label WHOLE: header.js.

import { floor, refuseUnless } from "./header.js";

export const MODEL = 35; // numbers of a model: 17 fast ones, 17 slow ones, and how many symbols it has seen
const SLOW = 17;
const SEEN = 34;

/** Rows of models that begin with equal shares, as many as tables need. */
export const FLAT = Array(11).fill(Array.from({ length: 16 }, (_, i) => 16 * i + 16));

/** Models that start as rows of 16 say. */
export function modelsOf(rows) {
  const models = new Uint16Array(MODEL * rows.length);
  rows.forEach((row, n) => {
    for (let i = 0, at = MODEL * n; i < 16; ) models[++at] = models[at + SLOW] = ((32704 * row[i]) >> 8) + 4 * ++i;
  });
  return models;
}

/** Where a symbol's share begins, of 32768, by the mean of two models, which may be the same; `one` and `two` say where
 * their numbers for the symbol are. */
export const edge = (models, one, two) =>
  (((models[one] + models[one + SLOW]) >> 1) + ((models[two] + models[two + SLOW]) >> 1)) >> 1;

/** Let the model that begins at `at` learn from a symbol. */
export function adapt(models, at, found) {
  const j = 31 - Math.clz32(models[at + SEEN] + 16);
  if (j < 7) models[at + SEEN]++;
  for (let i = 1; i < 16; i++) {
    const aim = 4 * i + (i > found ? 32704 : 0);
    const slow = ++at + SLOW;
    models[at] += (aim - models[at] + 15) >> 5;
    models[slow] += (aim - models[slow] + (1 << (j - 1)) - 1) >> j;
  }
}

/** How many bits follow a number's symbol. */
export const bitsAfter = (symbol) => (symbol > 3 && symbol < 15 ? (symbol >> 1) - 1 : 0);

/** The functions that decode a payload with these models. A state is 0 or 1; a short file has one state for both. */
export function newCoder(payload, models, isShort) {
  let [at, queue, held, rests] = [0, 0, 0, 0]; // the next byte, raw bits and how many, bits of numbers to come
  const byte = () => payload[at++] ?? 0;
  const half = () => byte() + 256 * byte();
  const states = new Uint32Array(isShort ? 1 : 2).map(() => half() + 65536 * half());

  WHOLE: refuseUnless(states.every((state) => state >= 65536), "its first state is too small");

  /** A symbol, by the mean of one or two models. */
  const symbol = (state, row, second = row) => {
    let which = 0;
    WHOLE: which = isShort ? 0 : state;
    const place = states[which] & 32767;
    const one = MODEL * row;
    const two = MODEL * second;
    let found = 0;
    let low = 0;
    let high;
    while ((high = edge(models, one + found + 1, two + found + 1)) <= place) {
      low = high;
      found++;
    }
    const next = (high - low) * (states[which] >>> 15) + place - low;
    states[which] = next < 65536 ? next * 65536 + half() : next;
    adapt(models, one, found);
    if (two !== one) adapt(models, two, found);
    return found;
  };

  /** Append whole bytes until the queue holds `count` bits: 49 of them at most, which a number holds. */
  const fill = (count) => {
    for (; held < count; held += 8) queue += byte() * 2 ** held;
  };

  /** Fetch the rests of the numbers since the last time, and some bits more. */
  const fetch = (more) => {
    fill(rests + more);
    rests = 0;
  };

  const take = (count) => {
    const bits = queue;
    queue = floor(bits / 2 ** count);
    held -= count;
    return bits - queue * 2 ** count;
  };

  /** A number, whose rest is still to be fetched and taken: its symbol, or 16 times the number and 15 if it has none. */
  const number = (state, row, second) => {
    const found = symbol(state, row, second);
    let bits = bitsAfter(found);
    if (found < 15) {
      rests += bits;
      return found;
    }
    fill(5);
    bits = take(5);
    fill(bits);
    return 16 * (2 ** bits + take(bits)) + 15;
  };

  /** The whole of a number, whose rest is taken. */
  const whole = (number) => {
    const bits = bitsAfter(number);
    return number < 4 ? number : number < 15 ? ((2 + (number & 1)) << bits) + take(bits) : (number - 15) / 16;
  };

  const bytesRead = () => at;

  /** Whether the payload ends as it must. */
  const isEnded = () =>
    states.every((state) => state === 65536) && !queue && payload.subarray(at).every((rest) => rest === 0);

  return [symbol, number, fetch, take, whole, bytesRead, isEnded];
}
