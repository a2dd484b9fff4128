// What a file holds, part by part, and what was left out of it.

import { $, element } from "../page/parts.js";
import { size } from "../page/words.js";

/** [name, bytes, or null for what was left out, words] for each part. The bytes add up to the file's. */
export function contentsOf({ bytes, start, textureBytes, alphaBytes, spent, grey, upright, texture }) {
  const { place, shape, slant, light, tint } = spent;
  const rest = 8 * (bytes - start) - place - shape - slant - light - tint;
  return [
    ["Places", place / 8, "where each is"],
    ["Sizes", shape / 8, "width and height"],
    upright ? ["Slant", null, "nothing leans"] : ["Slant", slant / 8, "how far it leans"],
    ["Light", light / 8, "brighter or darker"],
    grey ? ["Tint", null, "the picture is grey"] : ["Tint", tint / 8, "rest of the colour"],
    texture ? ["Texture", textureBytes, "how strong its noise is"] : ["Texture", null, "if tuned for the eye"],
    alphaBytes ? ["Alpha", alphaBytes, "what can be seen through"] : ["Alpha", null, "if it can be seen through"],
    ["Header", start - textureBytes - alphaBytes, "size and fineness"],
    ["Counts", rest / 8, "of each size"],
    ["Code tables", null, "learnt on the way"],
    ["Opacity", null, "it is a plain sum"],
  ];
}

/** Fill the table for a file; without one it is not shown. */
export function fillContents(file) {
  $("contents-card").hidden = !file;
  if (!file || file === fillContents.shown) return;
  fillContents.shown = file;
  const share = (bytes) => `${((100 * bytes) / file.bytes).toFixed(bytes < file.bytes / 100 ? 1 : 0)} %`;
  const rows = contentsOf(file).map(([name, bytes, words]) => {
    const told = [`${name} `, element("span", { className: "quiet small" }, words)];
    const figures =
      bytes === null
        ? [element("td", { colSpan: 2 }, "left out")]
        : [element("td", {}, size(Math.round(bytes))), element("td", {}, share(bytes))];
    const row = element("tr", {}, element("th", { scope: "row" }, ...told), ...figures);
    row.classList.toggle("out", bytes === null);
    return row;
  });
  $("contents").querySelector("tbody").replaceChildren(...rows);
}
