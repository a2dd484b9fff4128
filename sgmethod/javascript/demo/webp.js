// A picture as a WebP of so many characters in base64, at its best.

import { JUDGED_SIDE, SIDES } from "../src/encoder/settings.js";
import { largestWithin } from "../src/encoder/within.js";

/** A canvas with a picture reduced to a size. */
export function reduced(picture, width, height) {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, 0, 0, width, height);
  return canvas;
}

/** A picture reduced to a longer side, by halves first, so that every pixel counts. */
function withSide(picture, side) {
  const scale = Math.min(side / Math.max(picture.width, picture.height), 1);
  const [width, height] = [picture.width, picture.height].map((length) => Math.max(Math.round(length * scale), 1));
  while (picture.width > 2 * width) picture = reduced(picture, picture.width >> 1, Math.max(picture.height >> 1, 1));
  return reduced(picture, width, height);
}

const base64Length = (bytes) => 4 * Math.ceil(bytes / 3);
const levels = (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;

/** A WebP without what Chromium adds to the picture: half a kilobyte that says that its colours are sRGB. */
async function bare(blob) {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  const view = new DataView(bytes.buffer);
  const chunks = {};
  for (let at = 12, end; at < bytes.length; at = end) {
    end = at + 8 + view.getUint32(at + 4, true) + (bytes[at + 4] & 1);
    chunks[String.fromCharCode(...bytes.subarray(at, at + 4))] = bytes.slice(at, end);
  }
  const { VP8X: header, ALPH: alpha, "VP8 ": colours } = chunks;
  if (!colours) return blob;
  if (alpha) header[8] &= ~0x20; // it says that there is a colour profile
  const file = await new Blob([bytes.subarray(0, 12), ...(alpha ? [header, alpha] : []), colours]).arrayBuffer();
  new DataView(file).setUint32(4, file.byteLength - 8, true);
  return new Blob([file], { type: "image/webp" });
}

/** The WebP that is closest to a picture, ImageData, in no more characters; without a blob if none is so small. */
export async function webp(data, characters) {
  const picture = await createImageBitmap(data);
  const judged = withSide(picture, JUDGED_SIDE);
  const wanted = levels(judged);
  if ((await judged.convertToBlob({ type: "image/webp" })).type !== "image/webp") return { length: 0 };
  let [best, least] = [{ length: characters }, Infinity];
  for (const side of SIDES) {
    const small = withSide(picture, side);
    const [, blob] = await largestWithin(
      async (quality) => bare(await small.convertToBlob({ type: "image/webp", quality: quality / 100 })),
      ({ size }) => base64Length(size) <= characters,
      -1,
      101,
    );
    if (!blob) break; // larger ones are no smaller
    const drawn = levels(reduced(await createImageBitmap(blob), judged.width, judged.height));
    const error = wanted.reduce((sum, level, i) => sum + (level - drawn[i]) ** 2, 0);
    if (error < least) [best, least] = [{ blob, length: base64Length(blob.size) }, error];
  }
  return best;
}
