// The entropy decoder of versions 4 and 5: docs/format.md, "The entropy decoder of version 4".

export const COLOUR = 0; // the two states; a short file has one for both
export const SHAPE = 1;

/** A number whose last bits may still follow. */
export const NONE = Object.freeze({ least: 0, rest: 0, symbol: 0 });

export class Coder {
  constructor(payload, states) {
    this.payload = payload;
    this.at = 0;
    this.queue = new Uint8Array(32); // a ring of bytes, least significant bit first
    this.head = 0; // the bit that is taken next
    this.queued = 0; // bits
    this.states = Array.from({ length: states }, () => this.first());
    this.cost = 0; // bits of information decoded since somebody set it to 0
  }

  byte() {
    return this.at < this.payload.length ? this.payload[this.at++] : (this.at++, 0);
  }

  first() {
    return this.byte() + 256 * this.byte() + 65536 * this.byte() + 16777216 * this.byte();
  }

  get pastEnd() {
    return this.at > this.payload.length;
  }

  symbol(lane, model) {
    const which = lane % this.states.length;
    const state = this.states[which];
    const place = state % 32768;
    let symbol = 0;
    let low = 0;
    let high = model.edge(1);
    while (place >= high) {
      symbol++;
      low = high;
      high = model.edge(symbol + 1);
    }
    const next = (high - low) * Math.floor(state / 32768) + place - low;
    model.adapt(symbol);
    this.cost += 15 - Math.log2(high - low);
    this.states[which] = next < 65536 ? next * 65536 + this.byte() + 256 * this.byte() : next;
    return symbol;
  }

  /** Append whole bytes until the queue holds `count` bits. */
  fetch(count) {
    while (this.queued < count) {
      this.queue[((this.head + this.queued) >> 3) & 31] = this.byte();
      this.queued += 8;
    }
  }

  take(count) {
    this.cost += count;
    this.queued -= count;
    let value = 0;
    let weight = 1;
    while (count > 0) {
      const within = this.head & 7;
      const taken = Math.min(8 - within, count);
      value += ((this.queue[this.head >> 3] >> within) & ((1 << taken) - 1)) * weight;
      weight *= 2 ** taken;
      this.head = (this.head + taken) & 255;
      count -= taken;
    }
    return value;
  }

  number(which, model) {
    const symbol = this.symbol(which, model);
    if (symbol < 4) return { least: symbol, rest: 0, symbol };
    if (symbol < 15) {
      const rest = (symbol >> 1) - 1;
      return { least: (2 + (symbol & 1)) * 2 ** rest, rest, symbol };
    }
    this.fetch(5);
    const bits = this.take(5);
    this.fetch(bits);
    return { least: 2 ** bits + this.take(bits), rest: 0, symbol };
  }

  rest(number) {
    return number.least + this.take(number.rest);
  }

  /** Whether the payload ended as it has to. */
  get ended() {
    if (this.states.some((state) => state !== 65536) || this.take(this.queued) !== 0) return false;
    for (let i = this.at; i < this.payload.length; i++) if (this.payload[i]) return false;
    return true;
  }
}
