// An .sg file to its Gaussians: docs/format.md, "Version 5". Other versions, and parts this does not know, are refused.

import { COLOUR, Coder, NONE, SHAPE } from "./coder.js";
import { newModels } from "./models.js";

const SIGNATURE = [0xd3, 0xc5];
// Fields as sgmethod/bitstream/ has them: name, bits, bits in a short file, whether they grow. A test compares.
const HEADER = [
  ["flags", 5, 5, false],
  ["width", 4, 4, true],
  ["height", 4, 4, true],
  ["quantum", 12, 8, false],
  ["red", 8, 5, false],
  ["green", 8, 5, false],
  ["blue", 8, 5, false],
];
const ALPHA_HEADER = [
  ["alpha_quantum", 12, 8, false],
  ["alpha_background", 8, 5, false],
  ["alpha_bytes", 5, 5, true],
];
const MOST = { colour: 2 ** 22, exponent: 18, uBits: 12, partBits: 16, rawBits: 24, v: 8, r: 4096 };
const LEAST_COLOUR_STEP = 2 ** -16;
const LEAST_WIDTH = Math.fround(0.3);
const [GREY, UPRIGHT, TEXTURE, ALPHA, SHORT] = [1, 2, 4, 8, 16];
export const OCTAVES = 2;
export const CELL = 64; // pixels along a side of a cell of texture
const MOST_STRENGTH = 15;

/** A file that cannot be decoded. unknown: it may be a good one, of a kind that this decoder does not know. */
export class SgError extends Error {
  name = "SgError";
  constructor(message, unknown = false) {
    super(message);
    this.unknown = unknown;
  }
}

const refuseUnless = (holds, what) => {
  if (!holds) throw new SgError(`the file is damaged: ${what}`);
};

function crc32(bytes) {
  let crc = -1;
  for (const byte of bytes) {
    crc ^= byte;
    for (let i = 0; i < 8; i++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return ~crc >>> 0;
}

/** The fields of a header, one after the other from the first bit on. */
class HeaderBits {
  constructor(bytes, isShort) {
    [this.bytes, this.isShort, this.at] = [bytes, isShort, 0];
  }

  take(count) {
    refuseUnless(this.at + count <= 8 * this.bytes.length, "it ends within its header");
    let value = 0;
    for (; count > 0; count--, this.at++) value = 2 * value + ((this.bytes[this.at >> 3] >> (7 - (this.at & 7))) & 1);
    return value;
  }

  read(fields) {
    return fields.map(([, bits, shortBits, grows]) => {
      const value = this.take(this.isShort ? shortBits : bits);
      if (grows) return 2 ** value + this.take(value);
      return this.isShort ? (value << (bits - shortBits)) | (value >> (2 * shortBits - bits)) : value;
    });
  }

  /** In bytes. */
  get end() {
    refuseUnless(this.take(-this.at & 7) === 0, "its header does not end as it should");
    return this.at >> 3;
  }
}

const quantumOf = (code) => (1 + (code & 255) / 256) * 2 ** (3 - (code >> 8));

/** What the header says, and the bytes between it and the checksum. Throws SgError. */
function readHeader(bytes) {
  const isSigned = bytes[0] === SIGNATURE[0] && bytes[1] === SIGNATURE[1];
  if (!isSigned && ((bytes[0] === SIGNATURE[0] && bytes[1] >> 4 === 12) || String.fromCharCode(...bytes.subarray(0, 3)) === "SGM"))
    throw new SgError("this version of the file is not known here", true);
  if (!isSigned) throw new SgError("this is no .sg file");
  refuseUnless(bytes.length >= 7, "it is too short");
  const isShort = bytes[2] >= 128;
  const end = bytes.length - (isShort ? 1 : 4);
  const checksum = bytes.subarray(end).reduce((sum, byte) => 256 * sum + byte, 0);
  const whole = crc32(bytes.subarray(0, end));
  refuseUnless(checksum === (isShort ? whole & 255 : whole), "its checksum is wrong");
  const bits = new HeaderBits(bytes.subarray(2, end), isShort);
  const [flags] = bits.read(HEADER.slice(0, 1));
  const grey = Boolean(flags & GREY);
  const [width, height, quantum, ...levels] = bits.read(HEADER.slice(1, grey ? 5 : 7));
  const header = {
    width,
    height,
    grey,
    upright: Boolean(flags & UPRIGHT),
    isShort: Boolean(flags & SHORT),
    textured: Boolean(flags & TEXTURE),
    ofAlpha: flags & ALPHA ? bits.read(ALPHA_HEADER) : null,
    quantum: quantumOf(quantum),
    background: grey ? Array(3).fill(levels[0]) : levels,
  };
  const begin = 2 + bits.end;
  return { ...header, headerBytes: begin + bytes.length - end, parts: bytes.subarray(begin, end) };
}

/** The texture part: codes of strength for each octave, row by row, and where it ends. */
function readTexture(bytes, width, height) {
  const [columns, rows] = [Math.ceil(width / CELL), Math.ceil(height / CELL)];
  let at = 0; // bits
  const bit = () => {
    refuseUnless(at >> 3 < bytes.length, "it ends within its texture");
    return (bytes[at >> 3] >> (7 - (at++ & 7))) & 1;
  };
  const octaves = [];
  for (let octave = 0; octave < OCTAVES; octave++) {
    const sums = new Int32Array(columns * rows);
    const codes = sums.map((_, i) => {
      let ones = 0;
      while (bit()) ones++;
      const before = i % columns ? sums[i - 1] : i ? sums[i - columns] : 0;
      sums[i] = before + (ones & 1 ? -(ones + 1) / 2 : ones / 2);
      const code = sums[i] + (octave ? octaves[octave - 1][i] : 0);
      refuseUnless(code >= 0 && code <= MOST_STRENGTH, "a strength of texture is out of range");
      return code;
    });
    octaves.push(codes);
  }
  while (at & 7) refuseUnless(!bit(), "its texture does not end as it should");
  return { columns, rows, octaves, end: at >> 3 };
}

/** The Gaussians of a file, in its order: each has 8 numbers in `values` (x, y, l1, l2, l3, red, green, blue), how many
 * bits it took in `bits`, and in `ends` how many bytes of the payload are needed for it. `spent` has the bits by what
 * they say of all Gaussians. */
class Gaussians {
  constructor(room) {
    this.values = new Float32Array(8 * room);
    this.bits = new Float32Array(room);
    this.ends = new Uint32Array(room);
    this.count = 0;
    this.spent = { place: 0, shape: 0, slant: 0, light: 0, tint: 0 };
  }

  add(values, bits, end) {
    if (this.count === this.bits.length) this.grow();
    this.values.set(values, 8 * this.count);
    this.bits[this.count] = bits;
    this.ends[this.count++] = end;
  }

  grow() {
    for (const name of ["values", "bits", "ends"]) {
      const old = this[name];
      this[name] = new old.constructor(2 * old.length + 64);
      this[name].set(old);
    }
  }
}

/** Header and Gaussians of a file. Throws SgError. */
export function readFile(bytes) {
  const { parts, ofAlpha, ...header } = readHeader(bytes);
  const texture = header.textured ? readTexture(parts, header.width, header.height) : null;
  const textureBytes = texture ? texture.end : 0;
  const alphaBytes = ofAlpha ? ofAlpha[2] - 1 : 0;
  const start = textureBytes + alphaBytes;
  refuseUnless(start <= parts.length, "its alpha is cut short");
  return {
    ...header,
    texture,
    alpha: ofAlpha ? readAlpha(parts.subarray(textureBytes, start), ofAlpha, header) : null,
    textureBytes,
    alphaBytes,
    payloadBytes: parts.length - start,
    bytes: bytes.length,
    ...readPayload(header, parts.subarray(start)),
  };
}

/** Alpha: a grey picture of the same size, which can be drawn as a file can. */
function readAlpha(payload, [quantum, level], { width, height, isShort }) {
  const header = { width, height, isShort, grey: true, upright: false, quantum: quantumOf(quantum) };
  return { ...header, ...readPayload(header, payload), background: Array(3).fill(level), texture: null };
}

function readPayload(header, payload) {
  const found = new Gaussians(Math.ceil(payload.length / 3));
  if (payload.length) readGaussians(header, new Coder(payload, header.isShort ? 1 : 2), found);
  const { values, bits, ends, count, spent } = found;
  return {
    spent,
    count,
    values: values.slice(0, 8 * count),
    bits: bits.slice(0, count),
    ends: ends.slice(0, count),
  };
}

/** How many of the Gaussians are in the first part of a file, above 0 to 1. */
export function countInPart(file, part) {
  if (part >= 1) return file.count;
  const bytes = Math.ceil(part * file.payloadBytes);
  let [low, high] = [0, Math.min(file.count, 8 * bytes + 64)];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (file.ends[middle - 1] <= bytes) low = middle;
    else high = middle - 1;
  }
  return low;
}

function readGaussians(header, coder, found) {
  const models = newModels();
  const { width, height } = header;
  const most = Math.min(width * height, 2 ** 24, 8 * coder.payload.length + 64);
  refuseUnless(Math.min(...coder.states) >= 65536, "its first state is too small");
  coder.fetch(6);
  const first = 28 - coder.take(6);
  coder.fetch(6);
  const last = first - coder.take(6);
  refuseUnless(!coder.pastEnd && last >= -4, "its classes are out of range");
  let total = 0;
  for (let k = first; k >= last; k--) {
    const side = 2 ** Math.max(0, (k + 1) >> 1);
    const columns = Math.min(Math.floor(width / side) + 5, 65536);
    const rows = Math.min(Math.floor(height / side) + 5, 65536);
    const number = coder.number(COLOUR, models.count[0]);
    coder.fetch(number.rest);
    const n = coder.rest(number);
    refuseUnless(!coder.pastEnd && total + n <= most, "it has too many Gaussians");
    total += n;
    let t = 0;
    for (let mean = Math.floor((columns * rows) / Math.max(n, 1)); mean >= 8; mean = Math.floor(mean / 2)) t++;
    const ofClass = { k, t: Math.min(t, MOST.rawBits), columns, rows };
    let now = null;
    for (let i = 0; i < n + (n > 0); i++) {
      const before = now;
      now = readTurn(header, coder, models, ofClass, i < n, before, found.spent);
      if (!before) continue;
      refuseUnless(!coder.pastEnd, "it ends too early");
      found.add(before.values, before.bits, coder.at);
    }
  }
  refuseUnless(coder.ended, "its end is not as it should be");
}

const level = ({ symbol }) => (symbol === 0 ? 0 : symbol <= 2 ? 1 : symbol <= 5 ? 2 : 3);

/** Cell and colour of the next Gaussian, if there are more; shape and place of `now`, the one before, if any. */
function readTurn(header, coder, models, { k, t, columns, rows }, more, now, spent) {
  let [distance, y, a, b, v, r] = [NONE, NONE, NONE, NONE, NONE, NONE];
  let bits = 0; // of the next one's
  const ofNext = (what, read) => {
    coder.cost = 0;
    const value = read();
    bits += coder.cost;
    spent[what] += coder.cost;
    return value;
  };
  const ofNow = (what, read) => {
    coder.cost = 0;
    const value = read();
    now.bits += coder.cost;
    spent[what] += coder.cost;
    return value;
  };
  const bucket = now ? Math.min(now.h, 7) : 0;

  if (more) distance = ofNext("place", () => coder.number(COLOUR, models.distance[0]));
  if (now) {
    const [luma, second, third] = now.size;
    const which = 4 * (luma !== 0) + 2 * (second !== 0) + (third !== 0);
    const signs = ofNow("light", () => coder.symbol(SHAPE, models.colourSigns[which]));
    now.colour = now.size.map((value, i) => (signs & (4 >> i) ? -value : value));
  }
  if (more) y = ofNext("light", () => coder.number(COLOUR, models.luma[0]));
  if (now) v = ofNow("shape", () => coder.number(SHAPE, models.v[bucket]));
  if (more && !header.grey) a = ofNext("tint", () => coder.number(COLOUR, models.a[level(y)]));
  if (now && !header.upright) r = ofNow("slant", () => coder.number(SHAPE, models.r[bucket]));
  if (more && !header.grey) b = ofNext("tint", () => coder.number(COLOUR, models.b[level(a)]));

  coder.fetch(v.rest + r.rest + (now ? now.uBits : 0) + (more ? t : 0));
  let [px, py] = [0, 0];
  const shape = { u: 0, v: 0, r: 0 };
  if (now) {
    shape.v = ofNow("shape", () => coder.rest(v));
    shape.r = ofNow("slant", () => coder.rest(r));
    shape.u = ofNow("shape", () => coder.take(now.uBits));
    const most = 2 ** now.h;
    refuseUnless(shape.v <= MOST.v * most && shape.r <= (MOST.r * most) / 2, "a shape is out of range");
    const which = 2 * (shape.v !== 0) + (shape.r !== 0);
    const signs = ofNow("shape", () => coder.symbol(SHAPE, models.shapeSigns[which]));
    if (signs & 2) shape.v = -shape.v;
    if (signs & 1) shape.r = -shape.r;
    [px, py] = partBits(now, shape);
  }
  const low = more ? ofNext("place", () => coder.take(t)) : 0;

  coder.fetch(y.rest + a.rest + b.rest + distance.rest + px + py);
  let next = null;
  if (more) {
    const light = ofNext("light", () => coder.rest(y));
    const size = [light, ...ofNext("tint", () => [coder.rest(a), coder.rest(b)])];
    refuseUnless(size.some((value) => value > 0), "a Gaussian has no colour");
    refuseUnless(Math.max(...size) <= MOST.colour, "a colour is out of range");
    const cell = (now ? now.cell : 0) + ofNext("place", () => coder.rest(distance)) * 2 ** t + low;
    const [column, row] = [even(cell), even(Math.floor(cell / 2))];
    refuseUnless(cell < 2 ** 32 && column < columns && row < rows, "a place is out of range");
    next = half(k, cell, column, row, size);
    next.bits = bits;
  }
  if (now) {
    const [partX, partY] = ofNow("place", () => [coder.take(px), coder.take(py)]);
    now.values = valuesOf(header, now, shape, (partX + 0.5) / 2 ** px, (partY + 0.5) / 2 ** py);
  }
  return next;
}

/** A Gaussian whose cell and colour are known, but not the signs of the colour. */
function half(k, cell, column, row, size) {
  const square = size[0] * size[0] + size[1] * size[1] + size[2] * size[2];
  const h = Math.min(bitLength(square) >> 1, MOST.exponent);
  const uBits = Math.min(Math.max(h - 1, 0), MOST.uBits);
  return { k, cell, column, row, size, square, h, uBits, g: Math.max(0, (k + 1) >> 1), bits: 0, values: null };
}

/** The even bits of a number below 2^32. */
function even(number) {
  let n = number & 0x55555555;
  n = (n | (n >>> 1)) & 0x33333333;
  n = (n | (n >>> 2)) & 0x0f0f0f0f;
  n = (n | (n >>> 4)) & 0x00ff00ff;
  return (n | (n >>> 8)) & 0x0000ffff;
}

const bitLength = (x) => (x < 2 ** 32 ? 32 - Math.clz32(x) : 64 - Math.clz32(Math.floor(x / 2 ** 32)));

/** The logarithm to base two in sixteenths, linear between powers of two; of a BigInt. */
function lg(x) {
  const n = x.toString(2).length - 1;
  return 16 * n + Number((16n * x) >> BigInt(n)) - 16;
}

function lgSmall(x) {
  const n = bitLength(x) - 1;
  return 16 * n + Math.floor((16 * x) / 2 ** n) - 16;
}

/** By how many bits the cell is divided along x and y. */
function partBits({ k, g, h, square, uBits }, { u, v, r }) {
  const within = Math.floor((8 * (2 * u + 1)) / 2 ** uBits) - 8;
  const aspect = Math.floor((46 * v) / 2 ** h);
  const squares = 4 ** h + 4 * r * r; // exact below 2^53
  const slant = (squares < 2 ** 48 ? lgSmall(squares) : lg(4n ** BigInt(h) + 4n * BigInt(r) ** 2n)) - 32 * h;
  const fineness = lgSmall(square) + 32 * g - 17;
  const along = fineness + slant - Math.max(16 * k + within + aspect, -56);
  const across = fineness - Math.max(16 * k + within - aspect, -56);
  return [along, across].map((bits) => Math.min(Math.max((bits >> 5) + 1, 0), MOST.partBits));
}

/** Its last bit is the same everywhere. */
function exponential(x) {
  const z = x / 1024;
  let e = 1 + z * (1 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)));
  for (let i = 0; i < 10; i++) e *= e;
  return e;
}

/** From integers to the eight numbers that are drawn. */
function valuesOf(header, { k, g, h, uBits, column, row, colour }, { u, v, r }, partX, partY) {
  const step = 2 ** -h;
  const size = k & 1 ? 1.4142135623730951 * 2 ** ((k - 1) / 2) : 2 ** (k / 2);
  const within = ((u + 0.5) / 2 ** uBits - 0.5) * 0.34657359027997264;
  const l1 = Math.max(size * exponential(within + v * step), LEAST_WIDTH);
  const l3 = Math.max(size * exponential(within - v * step), LEAST_WIDTH);
  const c = Math.max(header.quantum / (size * 1.5), LEAST_COLOUR_STEP);
  const p = colour[0] * c * 0.57735026918962576;
  const q = colour[1] * c * 0.70710678118654752;
  const s = colour[2] * c * 0.40824829046386302;
  return [
    (column - 2 + partX) * 2 ** g,
    (row - 2 + partY) * 2 ** g,
    l1,
    r * (2 * step) * l3,
    l3,
    p + q + s,
    p - 2 * s,
    p - q + s,
  ];
}
