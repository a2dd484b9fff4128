// What an .sg file says before its Gaussians: docs/format.md, "Parts of a file". Other versions are refused.
//
// Here and in the modules beside it, statements with the label WHOLE belong to the whole decoder. The npm package's
// decoder of previews is built without them; it still finds damage, by the checksum and by how the payload ends.

export const { abs, ceil, exp, floor, fround, max, min, round, sqrt } = Math; // as formulas call them

// Fields as in sgmethod/bitstream/: bits, bits in a short file, whether they grow. A test compares them.
export const HEADER = [
  [5, 5, false], // flags
  [4, 4, true], // width
  [4, 4, true], // height
  [12, 8, false], // quantum
  [8, 5, false], // red
  [8, 5, false], // green
  [8, 5, false], // blue
];
export const ALPHA_HEADER = [
  [12, 8, false], // alpha_quantum
  [8, 5, false], // alpha_background
  [5, 5, true], // alpha_bytes
];
const GREY = 1;
const UPRIGHT = 2;
const TEXTURE = 4;
const ALPHA = 8;
export const OCTAVES = 2;
export const CELL = 64; // pixels along a side of a cell of texture

/** A file that cannot be decoded; if `unknown`, it may be valid, but of a kind that this decoder does not know. */
export class SgError extends Error {
  static name = "SgError"; // which minifying would shorten, and stack traces show
  name = "SgError";
}

export const unknown = (message) => Object.assign(new SgError(message), { unknown: true });

export const refuseUnless = (holds, what) => {
  if (!holds) throw new SgError(`the file is damaged: ${what}`);
};

/** Bytes as an array of them, which may be of another window. Throws TypeError. */
export function bytesOf(given, name) {
  const kind = Object.prototype.toString.call(given).slice(8, -1);
  if (kind === "Uint8Array" || kind === "Uint8ClampedArray") return given;
  if (kind.endsWith("ArrayBuffer")) return new Uint8Array(given);
  throw new TypeError(`${name} must be a Uint8Array, a Uint8ClampedArray or an ArrayBuffer, not ${kind}`);
}

/** Options, which may be left out. Throws TypeError. */
export function optionsOf(given = {}) {
  if (given === null || typeof given !== "object") throw new TypeError("options must be an object");
  return given;
}

export function crc32(bytes) {
  let crc = -1;
  for (const byte of bytes) {
    crc ^= byte;
    for (let i = 0; i < 8; i++) crc = (crc >>> 1) ^ (crc & 1 && 0xedb88320);
  }
  return ~crc >>> 0;
}

/** The header, with the payloads of the picture and of its alpha, a grey picture. readTexture(bit, width, height) reads
 * the texture. Throws SgError. */
export function readHeader(bytes, readTexture) {
  let isShort = true;
  WHOLE: isShort = bytes[2] > 127;
  const end = bytes.length - (isShort ? 1 : 4);
  let sum = bytes[end];
  WHOLE: sum = bytes.subarray(end).reduce((sum, byte) => 256 * sum + byte, 0);
  const whole = crc32(bytes.subarray(0, end));
  refuseUnless(sum === (isShort ? whole & 255 : whole), "its checksum is wrong");
  let at = 16; // bits
  const take = (count) => {
    refuseUnless(at + count <= 8 * end, "it ends too early");
    let value = 0;
    while (count-- > 0) value = 2 * value + ((bytes[at >> 3] >> (7 - (at++ & 7))) & 1);
    return value;
  };
  const read = ([bits, shortBits, grows]) => {
    const value = take(isShort ? shortBits : bits);
    if (grows) return 2 ** value + take(value);
    return isShort ? (value << (bits - shortBits)) | (value >> (2 * shortBits - bits)) : value;
  };
  const toByte = () => {
    const filling = take(-at & 7);
    WHOLE: refuseUnless(filling === 0, "bits that fill it are not zero");
    return at / 8;
  };
  const quantumOf = (code) => (1 + (code & 255) / 256) * 2 ** (3 - (code >> 8));
  const [flags, width, height, quantum, red] = HEADER.slice(0, 5).map(read);
  const grey = flags & GREY;
  const background = grey ? [red, red, red] : [red, ...HEADER.slice(5).map(read)];
  const header = { width, height, isShort, quantum: quantumOf(quantum), background, grey, upright: flags & UPRIGHT };
  const ofAlpha = flags & ALPHA ? ALPHA_HEADER.map(read) : null;
  let alphaAt = toByte();
  WHOLE: if (flags & TEXTURE) {
    header.texture = readTexture(() => take(1), width, height);
    alphaAt = toByte();
  }
  const payloadAt = alphaAt + (ofAlpha ? ofAlpha[2] - 1 : 0);
  WHOLE: refuseUnless(payloadAt <= end, "its alpha is cut short");
  if (ofAlpha) {
    const [code, level] = ofAlpha;
    header.alpha = { ...header, quantum: quantumOf(code), background: [level, level, level], grey: 1, upright: 0 };
    header.alpha.payload = bytes.subarray(alphaAt, payloadAt);
  }
  header.payload = bytes.subarray(payloadAt, end);
  return header;
}
