// Encodes previews: pictures of a few hundred bytes, as sgmethod.preview() in Python makes them.
//
//   const { text } = encodePreview(rgba, width, height, { bytes: 200 });
//
// reducing.js   the picture, to what its bytes can show
// targets.js    what Gaussians are to add up to
// fitting.js    Gaussians, to that: the schedule
// grid.js       their weights, the residual that they leave, derivatives
// growing.js    where another one pays
// refining.js   their integers
// settings.js   constants that are Python's
// integers.js   Gaussians and integers
// writing.js    integers and bytes
// uri.js        apart from these: a placeholder that needs no script
// within.js     the largest file within a number of bytes, for that

import { optionsOf } from "../header.js";
import { COARSE, FINE, expectedIn, fitted, quantumIn } from "./fitting.js";
import { fiveBits, quantumOf } from "./integers.js";
import { averaged, pictureOf, reducedSize } from "./reducing.js";
import { COARSER_ALPHA, DARK, NARROWEST_PX, PIXELS_PER_BYTE, SOFT_BYTES, SOFT_PX } from "./settings.js";
import { MIN_VISIBLE_CHANGE, decodedAlpha, ofAlpha, ofColours } from "./targets.js";
import { fileOf } from "./writing.js";

const { abs, floor, max, min, round, sqrt } = Math;

const [MIN_BYTES, MAX_BYTES] = [16, 1024];
const BYTES_OF_ALPHA = 1 / 2; // of those for Gaussians, at most

/** A preview of a picture.
 *
 * rgba: 8-bit RGBA of width x height pixels, row by row, as bytes or an ImageData; alpha is kept. bytes: maximum size
 * of the file, 16 to 1,024; three become four characters. Returns text and bytes, the picture's width, height and
 * average colour, "#rrggbb", and whether white text on that is easier to read than black. Throws TypeError if rgba is
 * something else or does not fit width and height, or for an unknown option, and RangeError for wrong bytes. */
export function encodePreview(rgba, width, height, options) {
  const { bytes = 200, ...others } = optionsOf(options);
  for (const name in others) throw new TypeError(`encodePreview() has no option ${name}, only bytes`);
  if (!(Number.isInteger(bytes) && bytes >= MIN_BYTES && bytes <= MAX_BYTES)) {
    throw new RangeError(`bytes must be a whole number from ${MIN_BYTES} to ${MAX_BYTES}`);
  }
  const [file, average] = encodeFile(rgba, width, height, bytes);
  const text = btoa(String.fromCharCode(...file.subarray(1)));
  return {
    text: text.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", ""),
    bytes: file,
    width,
    height,
    color: `#${average
      .map((level) =>
        round(255 * level)
          .toString(16)
          .padStart(2, "0"),
      )
      .join("")}`,
    dark: luminance(average) < DARK,
  };
}

/** The file of a picture, also a larger one than a preview's, and the average colour, 0 to 1. Throws TypeError. */
function encodeFile(rgba, width, height, bytes) {
  const picture = pictureOf(rgba, width, height);
  const size = reducedSize(width, height, PIXELS_PER_BYTE * bytes);
  const small = sqrt((size[0] * size[1]) / (PIXELS_PER_BYTE * bytes)); // below 1 for a picture that was small already
  const least = max(SOFT_PX * small * min(SOFT_BYTES / bytes, 1), NARROWEST_PX);
  const [coarse, fine] = picturesOf(picture, size, expectedIn(bytes), least);
  const [red, green, blue, alpha] = averaged(fine, 1, 1).means;
  const average = [red, green, blue].map((sum) => sum / (alpha || 1));
  return [encoded([coarse, fine], size, average, alpha, least, bytes), average];
}

/** Relative luminance of an sRGB colour (WCAG 2). */
function luminance(colour) {
  const [red, green, blue] = colour.map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
}

/** A picture with the samples that the coarse and the fine part of a fit need. */
function picturesOf(picture, [width, height], gaussians, least) {
  const [coarse, fine] = [COARSE, FINE].map(([each, along]) => {
    const scale = min(sqrt((each * gaussians) / (width * height)), along / least, 1);
    return [width, height].map((side) => max(round(side * scale), 1));
  });
  const finer = averaged(picture, ...fine);
  return [averaged(finer, ...coarse), finer];
}

/** The file of a picture of this size, given twice: coarse and fine. average, alpha: means. */
function encoded(pictures, [width, height], average, alpha, least, bytes) {
  const { means } = pictures[1];
  const all = (holds) => means.every((_, i) => i % 4 || holds(means[i], means[i + 1], means[i + 2], means[i + 3]));
  const grey = all((red, green, blue) => abs(red - green) < MIN_VISIBLE_CHANGE && abs(green - blue) < MIN_VISIBLE_CHANGE);
  const header = { width, height, grey, background: average.map(fiveBits), payload: [] };
  const room = (plane) => bytes - fileOf({ ...header, code: 0 }, plane).length;
  if (all((red, green, blue, shown) => shown > 1 - MIN_VISIBLE_CHANGE)) {
    const grids = pictures.map((picture) => ofColours(picture, header, average));
    return fileOf(fitted(grids, header, room(), least)[0]);
  }
  const empty = { width, height, grey: true, background: [alpha, alpha, alpha].map(fiveBits), payload: [] };
  const limit = floor(BYTES_OF_ALPHA * room({ ...empty, code: 0 }));
  const planes = pictures.map((picture) => ofAlpha(picture, empty));
  const finest = min(COARSER_ALPHA * quantumIn(bytes, header), quantumOf(0));
  const [plane, gaussians] = fitted(planes, empty, limit, least, finest);
  const shown = planes.map((grid) => decodedAlpha(grid, gaussians, plane));
  const grids = pictures.map((picture, k) => ofColours(picture, header, average, shown[k]));
  return fileOf(fitted(grids, header, room(plane), least)[0], plane);
}
