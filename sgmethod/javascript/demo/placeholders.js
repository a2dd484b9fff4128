// Other placeholders of a picture, each at its best within so many characters.

import { decode as decodeBlurHash, encode as encodeBlurHash } from "blurhash";
import { rgbaToThumbHash, thumbHashToRGBA } from "thumbhash";
import { JUDGED_SIDE, SIDES } from "../src/encoder/settings.js";
import { largestWithin } from "../src/encoder/within.js";

const HASHED_SIDE = 96; // 100 are the most that ThumbHash takes
const MOST_COMPONENTS = 9; // of a BlurHash, along a side

const canvasOf = (picture) => {
  const canvas = new OffscreenCanvas(picture.width, picture.height);
  canvas.getContext("2d").putImageData(picture, 0, 0);
  return canvas;
};

/** A picture reduced to a longer side, by halves first, so that every pixel counts. */
function reduced(picture, side) {
  let canvas = canvasOf(picture);
  const scale = Math.min(side / Math.max(picture.width, picture.height), 1);
  const [width, height] = [picture.width, picture.height].map((length) => Math.max(Math.round(length * scale), 1));
  while (canvas.width > 2 * width) canvas = resized(canvas, canvas.width >> 1, Math.max(canvas.height >> 1, 1));
  return resized(canvas, width, height);
}

function resized(source, width, height) {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(source, 0, 0, width, height);
  return canvas;
}

const pixelsOf = (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
const base64Length = (bytes) => 4 * Math.ceil(bytes / 3);

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

/** The WebP that is closest to the picture, in base64 no longer than that; without a blob if none is so small. */
export async function webp(picture, characters) {
  const judged = reduced(picture, JUDGED_SIDE);
  const { data } = pixelsOf(judged);
  if ((await judged.convertToBlob({ type: "image/webp" })).type !== "image/webp") return { length: 0 };
  let [best, least] = [{ length: characters }, Infinity];
  for (const side of SIDES) {
    const small = reduced(picture, side);
    const [, blob] = await largestWithin(
      async (quality) => bare(await small.convertToBlob({ type: "image/webp", quality: quality / 100 })),
      ({ size }) => base64Length(size) <= characters,
      -1,
      101,
    );
    if (!blob) break; // larger ones are no smaller
    const drawn = pixelsOf(resized(await createImageBitmap(blob), judged.width, judged.height)).data;
    const error = data.reduce((sum, level, i) => sum + (level - drawn[i]) ** 2, 0);
    if (error < least) [best, least] = [{ blob, length: base64Length(blob.size) }, error];
  }
  return best;
}

/** The BlurHash with most components, drawn. */
export function blurhash(picture, characters) {
  const { data, width, height } = pixelsOf(reduced(picture, HASHED_SIDE));
  let best = [1, 1];
  const off = ([x, y]) => Math.abs(Math.log(x / y / (width / height)));
  for (let x = 1; x <= MOST_COMPONENTS; x++) {
    for (let y = 1; y <= MOST_COMPONENTS; y++) {
      if (4 + 2 * x * y > characters || x * y < best[0] * best[1]) continue;
      if (x * y > best[0] * best[1] || off([x, y]) < off(best)) best = [x, y];
    }
  }
  const text = encodeBlurHash(data, width, height, ...best);
  return { text, data: decodeBlurHash(text, width, height), width, height };
}

/** The ThumbHash, drawn. */
export function thumbhash(picture) {
  const { data, width, height } = pixelsOf(reduced(picture, HASHED_SIDE));
  const hash = rgbaToThumbHash(width, height, data);
  const { w, h, rgba } = thumbHashToRGBA(hash);
  const text = btoa(String.fromCharCode(...hash)).replaceAll("=", "");
  return { text, data: new Uint8ClampedArray(rgba), width: w, height: h };
}
