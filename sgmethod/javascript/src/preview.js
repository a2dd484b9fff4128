// Pictures of a few hundred bytes, from their text: docs/format.md, "A file as text".

import { max, readHeader, refuseUnless } from "./header.js";
import { readGaussians } from "./payload.js";
import { drawGaussians, rounded, setAlpha } from "./planes.js";

export { SgError } from "./header.js";

/** The picture in a text, `size` pixels along its longer side: an ImageData, or in Node an object like it. Throws
 * SgError if the text is damaged or is no string, and RangeError for a size beyond 1 to 16,384. */
export function decodePreview(text, size = 256) {
  if (!(size >= 1 && size <= 16384)) throw new RangeError("size must be 1 to 16384");
  let binary;
  try {
    binary = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
  } catch {
    binary = ""; // which is refused
  }
  const again = btoa(binary).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  const bytes = Uint8Array.from(`\xd3${binary}`, (letter) => letter.charCodeAt(0));
  // Version 2, short, without texture; no padding, and nothing else that atob() ignores.
  refuseUnless(again === text && bytes[1] === 0xc2 && (bytes[2] & 160) === 128, "it is no preview");
  const header = readHeader(bytes);
  const sides = [header.width, header.height];
  const [width, height] = sides.map((side) => max(rounded((side * size) / max(...sides)), 1));
  const view = { left: 0, top: 0, width, height, sx: width / header.width, sy: height / header.height, dx: 0, dy: 0 };
  const pixels = (of) => drawGaussians(readGaussians(of, of.payload), of.background, view);
  const data = pixels(header);
  if (header.alpha) setAlpha(data, pixels(header.alpha));
  return globalThis.ImageData ? new ImageData(data, width) : { width, height, data };
}
