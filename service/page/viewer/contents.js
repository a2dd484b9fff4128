// How the bytes of a file are divided among its parts.

import { $, element } from "../parts.js";
import { size } from "../words.js";

/** [name, bytes, words] for each part that the file has. The bytes add up to the file's. */
function contentsOf({ headerBytes, payloadBytes, textureBytes, alphaBytes, spent }) {
  const { place, shape, slant, light, tint } = spent;
  const rest = 8 * payloadBytes - place - shape - slant - light - tint;
  return [
    ["Positions", place / 8, "centres of the ellipses"],
    ["Sizes", shape / 8, "widths and heights"],
    ["Slants", slant / 8, "how far they lean"],
    ["Brightness", light / 8, "lighter or darker"],
    ["Colour", tint / 8, "hue and saturation"],
    ["Texture", textureBytes, "strength of the noise"],
    ["Transparency", alphaBytes, "the alpha channel"],
    ["Header", headerBytes, "picture size, precision"],
    ["Counts", rest / 8, "ellipses of each size"],
  ].filter(([, part]) => part > 0);
}

/** Fill the table for a file, or hide it. */
export function fillContents(file) {
  $("contents-card").hidden = !file;
  if (!file || file === fillContents.shown) return;
  fillContents.shown = file;
  const share = (bytes) => `${((100 * bytes) / file.bytes).toFixed(bytes < file.bytes / 100 ? 1 : 0)} %`;
  const rows = contentsOf(file).map(([name, bytes, words]) => {
    const label = [`${name} `, element("span", { className: "quiet small" }, words)];
    const figures = [element("td", {}, size(Math.round(bytes))), element("td", {}, share(bytes))];
    return element("tr", {}, element("th", { scope: "row" }, ...label), ...figures);
  });
  $("contents").querySelector("tbody").replaceChildren(...rows);
}
