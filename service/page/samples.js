// The pictures that come with the page: an original, its .sg file, and an AVIF that is as large.

import { ask, bytesOf } from "./api.js";
import { $, element } from "./parts.js";
import { size } from "./words.js";

export const SAMPLES = ["coffee", "astronaut", "cat"];
export const THUMBNAIL_WIDTH = 216;
const at = (name, suffix) => `static/samples/${name}.${suffix}`;

/** Load a sample into an item, the small .sg file first. */
export async function openSample(item, sample) {
  const bytes = await bytesOf(at(sample, "sg"));
  Object.assign(item, { sample, url: at(sample, "sg"), otherUrls: { avif: at(sample, "avif") } });
  await item.setFile(bytes);
  await item.setOriginal(await (await ask(at(sample, "webp"))).blob());
}

/** Show the buttons, each with a picture drawn from an .sg file of a few kilobytes. */
export async function showSamples(opened, thumbnail) {
  const buttons = SAMPLES.map((sample) => {
    const canvas = element("canvas", { width: THUMBNAIL_WIDTH, height: 144 });
    const words = element("span", {}, sample);
    const button = element("button", { type: "button", id: `sample-${sample}` }, canvas, words);
    button.addEventListener("click", () => opened(sample));
    return { sample, canvas, words, button };
  });
  $("samples").replaceChildren(...buttons.map(({ button }) => button));
  for (const { sample, canvas, words } of buttons) {
    const bytes = await bytesOf(at(sample, "sg"));
    words.append(element("span", { className: "quiet" }, size(bytes.length)));
    const { data, width } = await thumbnail(bytes);
    canvas.getContext("2d").putImageData(new ImageData(data, width), 0, 0);
  }
}
