// Downloads: the file, pictures of any size, commands to repeat the encode, and a link.

import { MAX_PIXELS, MAX_SCALE } from "./sgmethod/drawing.js";
import { choices, drawn, hasKey, json } from "./api.js";
import { $ } from "./parts.js";
import { size, withoutSuffix } from "./words.js";

const IN_BROWSER = { png: "image/png", jpg: "image/jpeg", webp: "image/webp" };

/** Let the browser download a file, and return a sentence. */
export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  return `Downloaded ${name}, ${size(blob.size)}.`;
}

export const saveFile = async (item) => save(new Blob([item.sg]), `${withoutSuffix(item.name)}.sg`);

const widths = ([width, height]) => [
  Math.ceil(width / MAX_SCALE),
  Math.floor(Math.min(MAX_SCALE * width, Math.sqrt((MAX_PIXELS * width) / height))),
];

/** Limit the width field to the possible widths. */
export function offerWidths(size) {
  $("width").value = size[0];
  [$("width").min, $("width").max] = widths(size);
}

/** Save a picture, drawn here if it is opaque and the browser can write the format, else by the service. */
export async function savePicture(item, kind, width, draw) {
  const [whole] = item.size;
  const [min, max] = widths(item.size);
  if (!(width >= min && width <= max)) throw new Error(`the width must be between ${min} and ${max} pixels.`);
  const type = IN_BROWSER[kind];
  let blob = null;
  if (item.file && type && !item.file.alpha) {
    const picture = await draw(item.file, { scale: width / whole });
    const canvas = new OffscreenCanvas(picture.width, picture.height);
    canvas.getContext("2d").putImageData(new ImageData(picture.data, picture.width), 0, 0);
    blob = await canvas.convertToBlob({ type, quality: 0.9 });
  }
  if (!blob || blob.type !== type) blob = await drawn(item.sg, kind, width);
  return save(blob, `${withoutSuffix(item.name)}${width === whole ? "" : `-${width}`}.${kind}`);
}

/** Fill in the commands that make this file again, or fetch it. */
export function fillLines(item) {
  const { href: service } = new URL(".", location);
  const file = `${withoutSuffix(item.name)}.sg`.replace(/[^\w.-]/g, "_");
  const source = item.name.replace(/[^\w.-]/g, "_");
  const key = hasKey() ? "-H 'Authorization: Bearer KEY' " : "";
  if (item.budget) {
    const fields = choices(item.budget);
    const form = fields.map(([name, text]) => ` -F ${name}=${text}`).join("");
    const named = fields.map(([name, text]) => `, ${name}=${name === "tune" ? `"${text}"` : text}`).join("");
    $("curl").textContent = `curl ${key}-F image=@${source}${form} '${service}encode?wait=50' -o ${file}`;
    $("python").textContent = `import sgmethod\nsgmethod.encode("${source}"${named}).save("${file}")`;
  } else {
    const from = item.id ? `bitstreams/${item.id}.sg` : item.url;
    $("curl").textContent = from
      ? `curl ${key}${service}${from} -o ${file}`
      : `curl ${key}--data-binary @${file} ${service}decode.png -o ${withoutSuffix(file)}.png`;
    $("python").textContent = `import sgmethod\npixels = sgmethod.decode("${file}")`;
  }
}

/** A link to the page with this picture; with keys, one to its PNG that lasts an hour. */
export async function linkOf(item) {
  if (!item.id || !hasKey()) return new URL(`#${item.place}`, location).href;
  return location.origin + (await json(`jobs/${item.id}/links`, { method: "POST" })).decode_url;
}
