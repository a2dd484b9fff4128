// The table of other codecs: the Gaussians beside JPEG, WebP and AVIF, each with its size and its distance.

import { ask, jobPath } from "../api.js";
import { $, element, refill, Remote } from "../parts.js";
import { decibels, size } from "../words.js";

const CODECS = [
  ["JPEG", "image/jpeg", "jpg"],
  ["WebP", "image/webp", "webp"],
  ["AVIF", "image/avif", "avif"],
];
const NEAR = 0.03; // sizes that differ by no more than this share count as equal
const EQUAL_DB = 0.1;
const BETTER_SSIM = 0.002;

const worker = new Remote("static/viewer/comparisons_worker.js");
let last = Promise.resolve();

/** Measure a file and encode the picture by other codecs, one picture at a time. changed: called after each. */
export function measure(item, changed) {
  last = last.then(() => measureNow(item, changed)).catch((error) => console.warn(error.message));
  return last;
}

async function measureNow(item, changed) {
  if (!item.original || !item.decoded) return;
  const { width, height } = item.decoded;
  if (item.original.width !== width || item.original.height !== height) return;
  const bytes = item.sg.length;
  // both at once, since removing the item closes them
  [, item.measured] = await Promise.all([
    worker.ask("original", { image: item.original }),
    worker.ask("measure", { image: item.decoded }),
  ]);
  changed();
  for (const [name, type, suffix] of CODECS) {
    const other = await worker
      .ask("encode", { type, bytes, least: (1 - NEAR) * bytes })
      .then((made) => made ?? fetched(item, suffix))
      .catch((error) => ({ lacking: error.message }));
    item.others = { ...item.others, [name]: other };
    changed();
  }
}

/** Fetch a file that this browser cannot write: from beside the sample, or from the service. */
async function fetched(item, suffix) {
  const isKept = item.job && Date.now() < Date.parse(item.job.image_expires_at);
  const url = item.otherUrls?.[suffix] ?? (isKept && `${jobPath(item.id)}/comparison.${suffix}`);
  if (!url) return { lacking: item.id ? "the service no longer has the picture" : "this browser cannot write it" };
  const blob = await (await ask(url)).blob();
  const image = await createImageBitmap(blob, { premultiplyAlpha: "none" });
  return { image, bytes: blob.size, ...(await worker.ask("measure", { image })) };
}

const cell = (text) => element("td", {}, text);
const figures = (bytes, { psnr, ssim }) => [
  cell(size(bytes)),
  cell(decibels(psnr)),
  cell(ssim === null ? "" : ssim.toFixed(3)),
];

/** Fill the table for a picture. chosen: name of the file on the left; choose: called to change it. */
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
    const name = element("th", { scope: "row" }, "Gaussians");
    rows.push(element("tr", { className: "ours" }, name, ...figures(item.sg.length, item.measured)));
  }
  for (const [name] of item.measured ? CODECS : []) {
    const other = item.others?.[name];
    if (other?.image) rows.push(element("tr", {}, pick(name), ...figures(other.bytes, other)));
    else {
      const words = element("td", { colSpan: 3, className: "quiet" }, other?.lacking ?? "being made");
      rows.push(element("tr", {}, element("th", { scope: "row" }, name), words));
    }
  }
  refill($("others").querySelector("tbody"), rows);
  const made = Object.entries(item.others ?? {}).filter(([, other]) => other.image);
  $("verdict").textContent = item.measured ? verdict(item.sg.length, item.measured, Object.fromEntries(made)) : "";
  $("others-card").hidden = !item.measured;
}

/** Describe how the size differs from ours; empty if hardly. */
function differing(bytes, ours) {
  const ratio = bytes / ours;
  if (Math.abs(ratio - 1) <= NEAR) return "";
  if (ratio >= 2) return `, with ${ratio.toFixed(1)} times the bytes (${size(bytes)}),`;
  return `, with ${Math.round(100 * Math.abs(ratio - 1))} % ${ratio > 1 ? "more" : "fewer"} bytes (${size(bytes)}),`;
}

function distance(ahead) {
  if (ahead === Infinity) return "is further from the original, which the Gaussians match exactly";
  if (ahead === -Infinity) return "matches the original exactly";
  return `is ${Math.abs(ahead).toFixed(1)} dB ${ahead > 0 ? "further from" : "closer to"} the original`;
}

/** Compare with each other codec in a sentence, with its size if it differs from ours. */
export function verdict(bytes, measured, others) {
  const sentences = Object.entries(others).map(([name, other]) => {
    const ahead = other.psnr === measured.psnr ? 0 : measured.psnr - other.psnr;
    const isEqual = Math.abs(ahead) < EQUAL_DB;
    const but = ahead >= EQUAL_DB && other.ssim > measured.ssim + BETTER_SSIM ? ", but closer by SSIM" : "";
    return `${name}${differing(other.bytes, bytes)} ${isEqual ? "is as close to the original" : distance(ahead)}${but}.`;
  });
  return sentences.join(" ");
}
