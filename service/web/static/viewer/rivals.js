// The table of the same bytes: the Gaussians beside JPEG, WebP and AVIF, each with its size and its distance.

import { ask, jobPath } from "../page/api.js";
import { $, element, refill, Remote } from "../page/parts.js";
import { decibels, size } from "../page/words.js";

const CODECS = [
  ["JPEG", "image/jpeg", "jpg"],
  ["WebP", "image/webp", "webp"],
  ["AVIF", "image/avif", "avif"],
];

const worker = new Remote("/static/viewer/rivals_worker.js");
let last = Promise.resolve();

/** Measures a picture's file and makes its rivals; `told` is called after each. One picture at a time. */
export function measure(item, told) {
  last = last.then(() => measureNow(item, told)).catch((error) => console.warn(error.message));
  return last;
}

async function measureNow(item, told) {
  if (!item.original || !item.decoded) return;
  const { width, height } = item.decoded;
  if (item.original.width !== width || item.original.height !== height) return;
  const bytes = item.sg.length;
  await worker.ask("original", { image: item.original });
  item.measured = await worker.ask("measure", { image: item.decoded });
  told();
  for (const [name, type, suffix] of CODECS) {
    const rival = (await worker.ask("encode", { type, bytes })) ?? (await fetched(item, suffix));
    item.rivals = { ...item.rivals, [name]: rival };
    told();
  }
}

/** What this browser cannot write: a sample has it beside it, and the service makes it of the picture of a job. */
async function fetched(item, suffix) {
  const isKept = item.job && Date.now() < Date.parse(item.job.image_expires_at);
  const url = item.rivalUrls?.[suffix] ?? (isKept && `${jobPath(item.id)}/rival.${suffix}`);
  if (!url) return { lacking: item.id ? "the service no longer has the picture" : "this browser cannot write it" };
  try {
    const blob = await (await ask(url)).blob();
    const image = await createImageBitmap(blob, { premultiplyAlpha: "none" });
    return { image, bytes: blob.size, ...(await worker.ask("measure", { image })) };
  } catch (error) {
    return { lacking: error.message };
  }
}

const cell = (text) => element("td", {}, text);
const figures = (bytes, { psnr, ssim }) => [
  cell(size(bytes)),
  cell(decibels(psnr)),
  cell(ssim === null ? "" : ssim.toFixed(3)),
];

/** Fill the table for a picture; `chosen` names what is on the left, `choose` changes it. */
export function fillTable(item, chosen, choose) {
  const pick = (name) => {
    const button = element("button", { type: "button", className: "pick", ariaPressed: String(name === chosen) }, name);
    button.addEventListener("click", () => choose(name));
    return element("th", { scope: "row" }, button);
  };
  const rows = [];
  if (item.original) {
    rows.push(element("tr", {}, pick("Original"), cell(size(item.originalBytes)), cell("—"), cell("—")));
  }
  if (item.measured) {
    const name = element("th", { scope: "row", className: "ours" }, "Gaussians");
    rows.push(element("tr", { className: "ours" }, name, ...figures(item.sg.length, item.measured)));
  }
  for (const [name] of item.measured ? CODECS : []) {
    const rival = item.rivals?.[name];
    if (rival?.image) rows.push(element("tr", {}, pick(name), ...figures(rival.bytes, rival)));
    else {
      const words = element("td", { colSpan: 3, className: "quiet" }, rival?.lacking ?? "being made");
      rows.push(element("tr", {}, element("th", { scope: "row" }, name), words));
    }
  }
  refill($("rivals").querySelector("tbody"), rows);
  $("verdict").textContent = verdict(item);
  $("rivals-card").hidden = !item.measured;
}

/** Who is closer at the same bytes, in a sentence or two; also where it is not us. */
function verdict({ sg, measured, rivals = {} }) {
  if (!measured) return "";
  const sentences = [];
  for (const [name, rival] of Object.entries(rivals)) {
    if (!rival.image) continue;
    const ahead = measured.psnr - rival.psnr;
    if (rival.bytes > 1.03 * sg.length) {
      const more = (rival.bytes / sg.length).toFixed(1);
      sentences.push(`${name} cannot get this small: at its coarsest it takes ${more} times the bytes.`);
    } else if (Math.abs(ahead) < 0.1) sentences.push(`${name} is as close to the original.`);
    else if (ahead > 0) sentences.push(`${name} is ${ahead.toFixed(1)} dB further from the original.`);
    else sentences.push(`${name} is ${(-ahead).toFixed(1)} dB closer: here the Gaussians lose.`);
    if (ahead > 0.1 && rival.ssim > measured.ssim + 0.002) sentences.push(`By SSIM, ${name} is better.`);
  }
  return sentences.join(" ");
}
