// Decodes .sg files in a browser or in Node: decoder.wasm must lie beside this module.
//
//   import { decode, info } from "./decoder.js";
//   const picture = decode(new Uint8Array(await (await fetch("photo.sg")).arrayBuffer()), { scale: 0.5 });
//   context.putImageData(new ImageData(picture.data, picture.width), 0, 0);
//
// A page whose Content-Security-Policy names script sources has to allow 'wasm-unsafe-eval' among them.

const PROFILES = ["baseline", "paper", "rd"];

/** A file, or a view of it, that cannot be decoded. */
export class SgError extends Error {
  name = "SgError";
}

const module = await compiled(new URL("decoder.wasm", import.meta.url));

async function compiled(url) {
  if (url.protocol === "file:") {
    const { readFile } = await import("node:fs/promises");
    return WebAssembly.compile(await readFile(url));
  }
  const response = await fetch(url);
  if (!response.ok) throw new SgError(`${url} cannot be fetched: ${response.status}`);
  return WebAssembly.compile(await response.arrayBuffer());
}

/** An instance of its own for each file: its memory goes with it, whatever happened. */
function open(bytes) {
  if (bytes instanceof ArrayBuffer) bytes = new Uint8Array(bytes);
  if (!(bytes instanceof Uint8Array)) throw new SgError("an .sg file must be given as a Uint8Array or an ArrayBuffer");
  const refused = (at) => {
    const text = new Uint8Array(kernels.memory.buffer, at);
    throw new SgError(new TextDecoder().decode(text.subarray(0, text.indexOf(0))));
  };
  const kernels = new WebAssembly.Instance(module, { sg: { refused } }).exports;
  return run(() => {
    kernels._initialize();
    const at = kernels.room(bytes.length); // before its memory is looked at, which may move
    new Uint8Array(kernels.memory.buffer, at, bytes.length).set(bytes);
    kernels.open();
    return kernels;
  });
}

/** What is no SgError is memory that has run out. */
function run(call) {
  try {
    return call();
  } catch (error) {
    if (error instanceof WebAssembly.RuntimeError) throw new SgError("out of memory", { cause: error });
    throw error;
  }
}

/** What a file says of itself: version, profile, width, height, checksum, gaussians, background, alpha, bytes, bpp. */
export function info(bytes) {
  const kernels = open(bytes);
  const at = run(() => kernels.info());
  const fields = new Float64Array(kernels.memory.buffer, at, 10);
  const [version, profile, width, height, checksum, gaussians, red, green, blue, alpha] = fields;
  return {
    bytes: bytes.byteLength,
    bpp: (8 * bytes.byteLength) / (width * height),
    version,
    checksum: checksum.toString(16).padStart(8, "0"),
    profile: PROFILES[profile],
    width,
    height,
    gaussians,
    background: [red, green, blue],
    alpha: Boolean(alpha),
  };
}

/**
 * The picture in a file, or a view of it: { width, height, data }, data being RGBA of 8 bits, row by row.
 *
 * scale: output pixels for a pixel of the picture, 1/64 to 64; region: [x, y, width, height] in pixels of the picture;
 * prefix: the part of the file that may be used, above 0 to 1; texture: whether it is drawn. Throws SgError.
 */
export function decode(bytes, { scale = 1, region = null, prefix = 1, texture = true } = {}) {
  const whole = region === null;
  const area = whole ? [0, 0, 0, 0] : [...region];
  if (area.length !== 4 || !area.every((n) => Number.isInteger(n) && Math.abs(n) < 2 ** 31))
    throw new SgError("a region is four whole numbers x, y, width, height");
  const kernels = open(bytes);
  const fields = run(() => kernels.draw(scale, prefix, ...area, whole, texture));
  const [width, height, at] = new Float64Array(kernels.memory.buffer, fields, 3);
  const data = new Uint8ClampedArray(kernels.memory.buffer, at, 4 * width * height).slice();
  return { width, height, data };
}
