// The entropy decoder of version 2: docs/format.md, "States and symbols" and "Raw bits and numbers".

import { min, refuseUnless } from "./header.js";
import { SEEN, SLOW, newModels } from "./models.js";

/** Where the share of a symbol begins, of 32768. */
export const edge = (model, symbol) => (model[symbol] + model[symbol + SLOW]) >> 1;

/** Let a model learn from a symbol. */
export function adapt(model, found) {
  const j = min(31 - Math.clz32(model[SEEN]++ + 16), 7);
  for (let i = 1; i < 16; i++) {
    const aim = 4 * i + (i > found && 32704);
    model[i] += (aim - model[i] + 15) >> 5;
    model[i + SLOW] += (aim - model[i + SLOW] + (1 << (j - 1)) - 1) >> j;
  }
}

/** The functions that decode a payload. A state is 0 or 1; a short file has one state for both. onCost(bits, state,
 * row) is called for each value decoded, with the bits of information that it took and the row of its model. */
export function newCoder(payload, isShort, onCost) {
  const models = newModels();
  const queue = new Uint8Array(64); // of raw bits, a ring
  let [at, head, tail] = [0, 0, 0]; // the next byte, the first bit of the queue, its end
  const byte = () => payload[at++] ?? 0;
  const half = () => byte() + 256 * byte();
  const first = () => half() + 65536 * half();
  const states = [first()];
  WHOLE: if (!isShort) states.push(first());

  WHOLE: refuseUnless(states.every((state) => state >= 65536), "its first state is too small");

  const symbol = (state, row) => {
    const model = models[row];
    let which = 0;
    WHOLE: which = isShort ? 0 : state;
    const place = states[which] & 32767;
    let found = 0;
    while (place >= edge(model, found + 1)) found++;
    const low = edge(model, found);
    const share = edge(model, found + 1) - low;
    const next = share * (states[which] >>> 15) + place - low;
    states[which] = next < 65536 ? next * 65536 + half() : next;
    adapt(model, found);
    WHOLE: onCost?.(15 - Math.log2(share), state, row);
    return found;
  };

  /** Append whole bytes until the queue holds `count` bits. */
  const fetch = (count) => {
    while (tail - head < count) for (let bits = byte() + 256; bits > 1; bits >>= 1) queue[tail++ & 63] = bits & 1;
  };

  const take = (count, state, row) => {
    let value = 0;
    for (let weight = 1; weight < 2 ** count; weight *= 2) value += queue[head++ & 63] * weight;
    WHOLE: onCost?.(count, state, row);
    return value;
  };

  /** A number whose last bits may still be in the queue: its least value, how many bits, its symbol, state and row. */
  const number = (state, row) => {
    const found = symbol(state, row);
    if (found < 4) return [found, 0, found];
    if (found < 15) return [(2 + (found & 1)) << ((found >> 1) - 1), (found >> 1) - 1, found, state, row];
    fetch(5);
    const bits = take(5, state, row);
    fetch(bits);
    return [2 ** bits + take(bits, state, row), 0, found];
  };

  const bytesRead = () => at;

  /** Whether the payload ends as it must. */
  const isEnded = () =>
    states.every((state) => state === 65536) && !take(tail - head) && payload.subarray(at).every((rest) => rest === 0);

  return [symbol, fetch, take, number, bytesRead, isEnded];
}
