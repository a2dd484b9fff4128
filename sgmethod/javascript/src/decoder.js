// Decodes .sg files of version 2, in a browser or elsewhere:
//
//   const { width, height, data } = decode(bytes, { scale: 0.5 });
//   context.putImageData(new ImageData(data, width), 0, 0);

import { draw } from "./drawing.js";
import { countInPart, readFile } from "./file.js";

export { SgError } from "./header.js";

/**
 * The picture in a file, or a view of it: { width, height, data }, data being RGBA of 8 bits, row by row.
 *
 * bytes: a Uint8Array; scale: output pixels for a pixel of the picture, 1/64 to 64; region: [x, y, width, height] in
 * pixels of the picture; prefix: the part of the file that may be used, above 0 to 1; texture: whether it is drawn.
 * Throws SgError.
 */
export function decode(bytes, { scale = 1, region = null, prefix = 1, texture = true } = {}) {
  if (!(prefix > 0 && prefix <= 1)) throw new RangeError("prefix must be above 0, and at most 1");
  const file = readFile(bytes);
  return draw(file, { scale, region, count: countInPart(file, prefix), texture });
}
