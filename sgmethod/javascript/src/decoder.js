// Decodes .sg files of version 2, in a browser or elsewhere:
//
//   const { width, height, data } = decode(bytes, { scale: 0.5 });
//   context.putImageData(new ImageData(data, width), 0, 0);

import { draw } from "./drawing.js";
import { countInPart, readFile } from "./file.js";
import { bytesOf, optionsOf } from "./header.js";

export { SgError } from "./header.js";

/**
 * The picture in a file, or a view of it: { width, height, data }, where data is 8-bit RGBA, row by row.
 *
 * bytes: a Uint8Array or an ArrayBuffer; region: [x, y, width, height] in pixels of the picture; scale: output pixels
 * for a pixel of the picture, 1/64 to 64; or width, height: pixels into which the output fits; prefix: the part of the
 * file that may be used, above 0 to 1; texture: whether to draw it. Throws SgError; TypeError or RangeError for wrong
 * arguments.
 */
export function decode(bytes, view) {
  const { scale: asked, width, height, region = null, prefix = 1, texture = true, ...others } = optionsOf(view);
  for (const name in others) throw new TypeError(`decode() has no option ${name}`);
  if (!(prefix > 0 && prefix <= 1)) throw new RangeError("prefix must be above 0, and at most 1");
  const isFitted = width !== undefined || height !== undefined;
  if (isFitted && asked !== undefined) throw new TypeError("scale cannot be combined with width or height");
  if (region !== null && region.length !== 4) throw new TypeError("region must be [x, y, width, height]");
  const file = readFile(bytesOf(bytes, "bytes"));
  const [, , w, h] = region ?? [0, 0, file.width, file.height];
  const scale = isFitted ? Math.min((width ?? Infinity) / w, (height ?? Infinity) / h) : asked;
  return draw(file, { scale, region, count: countInPart(file, prefix), texture });
}

/** What a file contains: size in pixels, Gaussians, whether it has alpha and texture. Throws SgError, or TypeError for
 * what are no bytes. */
export function info(bytes) {
  const { width, height, count, alpha, texture } = readFile(bytesOf(bytes, "bytes"));
  return { width, height, gaussians: count + (alpha?.count ?? 0), alpha: Boolean(alpha), texture: Boolean(texture) };
}
