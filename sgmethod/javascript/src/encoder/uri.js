// Placeholders that need no script: a photograph itself, as a small WebP or PNG in a data URI.

import { crc32, optionsOf } from "../header.js";
import { averaged, pictureOf } from "./reducing.js";
import { JUDGED_SIDE, SIDES } from "./settings.js";
import { largestWithin } from "./within.js";

const { floor, max, min, round } = Math;

const PNG_SIDES = [4, 32]; // at least and at most
const [COLOURS, PASSES] = [8, 8]; // docs/notebook/service.md
const OPAQUE = 1 - 1 / 512;

/** A promise of a data URI of at most so many characters that shows a picture; "" if nothing fits, or if the picture
 * has transparency. rgba, width, height: as for encodePreview(); sharp: the module, for the best WebP. Without it, the URI
 * holds a PNG of eight colours and at most 32 pixels a side. */
export async function dataUri(rgba, width, height, options) {
  const { characters = 400, sharp, ...others } = optionsOf(options);
  for (const name in others) throw new TypeError(`dataUri() has no option ${name}, only characters and sharp`);
  if (!(characters > 0)) throw new RangeError("characters must be a number above 0");
  const picture = averaged(pictureOf(rgba, width, height), ...sizeWithin(width, height, JUDGED_SIDE));
  for (let at = 3; at < picture.means.length; at += 4) if (picture.means[at] < OPAQUE) return "";
  const prefix = `data:image/${sharp ? "webp" : "png"};base64,`;
  const maxBytes = 3 * floor((characters - prefix.length) / 4);
  const file = await (sharp ? bestWebp(picture, maxBytes, sharp) : bestPng(picture, maxBytes));
  return file ? prefix + btoa(String.fromCharCode(...file)) : "";
}

const sizeWithin = (width, height, longest) =>
  [width, height].map((side) => max(round(side * min(longest / max(width, height), 1)), 1));

/** A picture as 8-bit RGB. */
function reduced({ means, columns, rows }, longest) {
  const [width, height] = sizeWithin(columns, rows, longest);
  const small = averaged({ means, columns, rows }, width, height).means;
  const rgb = Uint8ClampedArray.from({ length: 3 * width * height }, (_, i) => 255 * small[i + floor(i / 3)]);
  return { rgb, width, height };
}

async function bestWebp(picture, maxBytes, sharp) {
  const judged = reduced(picture, JUDGED_SIDE);
  const { width, height } = judged;
  let [best, least] = [null, Infinity];
  for (const side of SIDES) {
    const file = await finestWebp(reduced(picture, side), maxBytes, sharp);
    if (!file) continue;
    const drawn = await sharp(file).resize(width, height, { kernel: "cubic", fit: "fill" }).removeAlpha().raw().toBuffer();
    const error = judged.rgb.reduce((sum, level, i) => sum + (level - drawn[i]) ** 2, 0);
    if (error < least) [best, least] = [file, error];
  }
  return best;
}

const finestWebp = ({ rgb, width, height }, maxBytes, sharp) =>
  largest(maxBytes, 1, 100, (quality) =>
    sharp(rgb, { raw: { width, height, channels: 3 } }).webp({ quality, effort: 6 }).toBuffer(),
  );

const bestPng = (picture, maxBytes) => largest(maxBytes, ...PNG_SIDES, (side) => pngOf(reduced(picture, side)));

/** The file of the highest number, from low to high, that has at most so many bytes; null if none has. */
const largest = async (maxBytes, low, high, fileOf) =>
  (await largestWithin(fileOf, (file) => file.length <= maxBytes, low - 1, high + 1))[1];

async function pngOf({ rgb, width, height }) {
  const [palette, nearest] = paletteOf(rgb);
  const stride = 1 + ((width + 1) >> 1); // no filter, then two samples a byte
  const rows = new Uint8Array(stride * height);
  nearest.forEach((colour, i) => {
    const x = i % width;
    rows[stride * floor(i / width) + 1 + (x >> 1)] |= colour << (x & 1 ? 0 : 4);
  });
  const packed = new Blob([rows]).stream().pipeThrough(new CompressionStream("deflate"));
  const chunks = [
    ["IHDR", [...fourBytes(width), ...fourBytes(height), 4, 3, 0, 0, 0]],
    ["PLTE", palette],
    ["IDAT", new Uint8Array(await new Response(packed).arrayBuffer())],
    ["IEND", []],
  ].map(([name, data]) => {
    const named = [...Array.from(name, (letter) => letter.charCodeAt(0)), ...data];
    return [...fourBytes(data.length), ...named, ...fourBytes(crc32(named))];
  });
  return [137, 80, 78, 71, 13, 10, 26, 10, ...chunks.flat()];
}

const fourBytes = (number) => [24, 16, 8, 0].map((shift) => (number >>> shift) & 255);

/** Colours that stand for all of a picture's, by k-means from evenly spaced ranks of brightness, and which is nearest to
 * each pixel. */
function paletteOf(rgb) {
  const nearest = new Uint8Array(rgb.length / 3);
  const brightness = (i) => 3 * rgb[3 * i] + 6 * rgb[3 * i + 1] + rgb[3 * i + 2];
  const sorted = Array.from(nearest, (_, i) => i).sort((one, other) => brightness(one) - brightness(other));
  let palette = Uint8ClampedArray.from({ length: 3 * COLOURS }, (_, i) => {
    const rank = floor(((floor(i / 3) + 0.5) * sorted.length) / COLOURS);
    return rgb[3 * sorted[rank] + (i % 3)];
  });
  for (let pass = 0; ; pass++) {
    const sums = new Float64Array(4 * COLOURS);
    for (let i = 0, at = 0; at < rgb.length; i++, at += 3) {
      let least = Infinity;
      for (let k = 0; k < COLOURS; k++) {
        const [red, green, blue] = [0, 1, 2].map((c) => rgb[at + c] - palette[3 * k + c]);
        const distance = red * red + green * green + blue * blue;
        if (distance < least) [least, nearest[i]] = [distance, k];
      }
      [rgb[at], rgb[at + 1], rgb[at + 2], 1].forEach((value, c) => (sums[4 * nearest[i] + c] += value));
    }
    if (pass === PASSES) return [palette, nearest];
    palette = palette.map((level, i) => {
      const k = floor(i / 3);
      return sums[4 * k + 3] ? sums[i + k] / sums[4 * k + 3] : level;
    });
  }
}
