// The status of a picture: its labels, its progress, its row in the list.

import { $, element, refill } from "./parts.js";
import { closeness, count, decibels, qualityWord, seconds, size, smaller } from "./words.js";

const SHARED = "Shared: the original is not part of the link, so there is nothing to compare with.";
export const TITLES = { failed: "That did not work", cancelled: "Cancelled" };

/** Announce something new to screen readers, once. */
function say(words) {
  if ($("announcement").textContent !== words) $("announcement").textContent = words;
}

export function trouble(words) {
  $("trouble").textContent = words;
  $("trouble").hidden = !words;
  if (words) setTimeout(() => $("trouble").textContent === words && trouble(""), 12_000);
}

function label(id, seen, name, ...words) {
  $(id).hidden = !seen;
  $(id).replaceChildren(element("b", {}, name), ...words.filter(Boolean).map((text) => element("span", {}, text)));
}

/** Show the labels on the picture. leftName: the file on the left; part: bytes of the file that are drawn, 0 for all;
 * smooth: without texture. */
export function showLabels(item, leftName, isLeft, part, smooth) {
  const other = item.others?.[leftName];
  if (other && isLeft) label("left-label", true, leftName, size(other.bytes));
  else label("left-label", isLeft, "Original", size(item.originalBytes ?? 0));
  const bytes = item.sg && size(item.sg.length);
  if (part) label("right-label", item.decoded, "Gaussians", `the first ${size(part)} of ${bytes}`);
  else if (smooth) label("right-label", item.decoded, "Gaussians", bytes, "without texture");
  else label("right-label", item.decoded, "Gaussians", bytes);
  $("outcome").textContent = item.decoded ? outcomeOf(item) : "";
  $("outcome").hidden = item.busy || Boolean(item.opened);
  const unseen = item.source && !item.original && item.state !== "failed" && "This browser cannot show the original.";
  const laid = item.wasTransparent && "Transparent areas are shown on white here, and stay transparent in the file.";
  const linked = item.id && !item.source && item.decoded && SHARED;
  $("note").textContent = item.note || unseen || laid || linked || "";
  $("note").hidden = !$("note").textContent;
}

const sentence = (words) => `${words[0].toUpperCase()}${words.slice(1)}${/[.!?]$/.test(words) ? "" : "."}`;

/** Show the progress of its job, and the chart of the fit if it was tuned for PSNR. */
export function showWork(item) {
  $("work").hidden = !item.busy && !TITLES[item.state];
  $("work").classList.toggle("bad", item.state === "failed");
  $("work").querySelector("h2").textContent = TITLES[item.state] ?? "In progress";
  $("status").textContent = item.state === "failed" ? sentence(item.words) : item.words;
  $("progress").hidden = !item.busy;
  if (item.done === null) $("progress").removeAttribute("value");
  else $("progress").value = item.done;
  $("cancel").hidden = !item.busy;
  if (item.busy) say(item.state === "running" ? "Encoding" : item.words);
  else if (item.state === "done") say(`${item.name} is done: ${size(item.sg.length)}`);
  else say(item.words);
  const trace = item.job?.tune === "psnr" ? item.trace : [];
  const end = item.state === "done" ? (item.job?.result?.psnr ?? null) : null;
  $("chart-card").hidden = !trace.length;
  if (trace.length) import("./progress.js").then(({ drawTrace }) => drawTrace(trace, end));
  $("figures-field").hidden = !item.decoded;
  $("figures").textContent = item.decoded ? figuresOf(item) : "";
}

const bitsPerPixel = (sg, [width, height]) => `${((8 * sg.length) / (width * height)).toFixed(2)} bits per pixel`;

/** The result in a sentence: of a job by its figures, of a sample as it is measured here. */
function outcomeOf({ sg, size: pixels, originalBytes, job, measured }) {
  if (!originalBytes) return "";
  const words = `${smaller(originalBytes, sg.length)} than the original`;
  if (!job?.result) return sentence(measured?.ssim ? `${words}; ${closeness(measured.ssim)}` : words);
  const score = job.result.ssimulacra2 ?? null;
  const looks = score === null ? [] : [`SSIMULACRA 2 ${score.toFixed(0)} (${qualityWord(score)})`];
  const figures = [size(sg.length), bitsPerPixel(sg, pixels), ...looks, seconds(job.result.seconds)];
  return sentence(`${figures.join(", ")}; ${words}`);
}

function figuresOf({ sg, file, size: [width, height], job, measured }) {
  const gaussians = file?.count ?? job?.result?.gaussians;
  const psnr = measured?.psnr ?? job?.result?.psnr;
  const parts = [`${width} × ${height} pixels`];
  if (gaussians) parts.push(`${count(gaussians)} Gaussians`);
  parts.push(`${size(sg.length)}, ${bitsPerPixel(sg, [width, height])}`);
  if (psnr) parts.push(`PSNR ${decibels(psnr)}`);
  if (measured?.ssim) parts.push(`SSIM ${measured.ssim.toFixed(2)}`);
  return `${parts.join(" · ")}.`;
}

function stateInShort({ state, sg, done }) {
  if (state === "done") return size(sg.length);
  if (state === "running") return `${Math.round(100 * (done ?? 0))} %`;
  const short = { sending: "sending", queued: "waiting", failed: "failed", cancelled: "cancelled" };
  return short[state] ?? "";
}

/** Fill the list of pictures. show, remove: called with the picture that is clicked. */
export function showRows(items, current, show, remove) {
  $("rows-card").hidden = items.length < 2;
  const rows = items.map((item) => {
    const state = stateInShort(item);
    const pick = element("button", { type: "button", className: "pick", ariaPressed: String(item === current) });
    pick.append(element("span", { className: "name" }, item.name), element("span", { className: "quiet" }, state));
    pick.addEventListener("click", () => show(item));
    const close = element("button", { type: "button", ariaLabel: `Remove ${item.name} from the list` }, "×");
    close.addEventListener("click", () => remove(item));
    return element("li", {}, pick, close);
  });
  refill($("rows"), rows);
}
