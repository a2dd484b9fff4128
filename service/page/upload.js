// Choosing pictures, and the budget of an encode.

import { local, remembered, session } from "./storage.js";
import { $ } from "./parts.js";
import { expected, qualityWord, size, smaller } from "./words.js";

/** What the service aims at unless asked for something else: a SSIMULACRA 2, in at most so many bits per pixel. */
export const USUAL = { quality: 60, max_bpp: 0.5 };
const USUAL_SIZE_BPP = 0.25; // once a size is asked for
const AIMS = { bytes: ["Bytes", 20000], psnr: ["dB", 32] };

/** Call `given` with files that are chosen, dropped or pasted. */
export function listen(given) {
  $("choose").addEventListener("click", () => $("file").click());
  $("file").addEventListener("change", () => {
    given([...$("file").files]);
    $("file").value = ""; // so that the same file can be picked again
  });
  let inside = 0; // of how many nested elements the pointer is
  const over = (change) => {
    inside = change === 0 ? 0 : inside + change;
    $("over").hidden = inside <= 0;
  };
  const files = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragenter", (event) => files(event) && over(1));
  addEventListener("dragleave", (event) => files(event) && over(-1));
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    over(0);
    if (event.dataTransfer.files.length) given([...event.dataTransfer.files]);
  });
  addEventListener("paste", (event) => {
    if (!event.clipboardData.files.length) return;
    event.preventDefault();
    given([...event.clipboardData.files]);
  });
}

/** The slider's bytes: 100 to 1,000,000, each step about 5 % more, in two digits. */
const LEAST = 100;
const bytesAt = (place) => Number((LEAST * 1e4 ** (place / 100)).toPrecision(2));
const placeOf = (bytes) => (100 * Math.log(bytes / LEAST)) / Math.log(1e4);

/** The size unless the slider is moved. Of a picture that the browser cannot show, the number of pixels is unknown. */
const usualBytes = (item) => (item?.size ? Math.max(Math.floor((USUAL_SIZE_BPP * item.size[0] * item.size[1]) / 8), LEAST) : 5e4);
const isMoved = () => "sgmethod-slider" in local;
const bytes = (item) => (isMoved() ? bytesAt($("slider").value) : usualBytes(item));

/** SSIMULACRA 2, 5 to 95. */
const quality = () => (isMoved() ? Math.round(5 + 0.9 * Number($("slider").value)) : USUAL.quality);
const placeOfQuality = (score) => (score - 5) / 0.9;

/** What a control has unless the visitor changes it, which is the service's default. */
const usualOf = (control) => [...(control.options ?? [])].find((one) => one.defaultSelected)?.value ?? "";
const controls = (kind) => [...document.querySelectorAll(`${kind}[data-option]`)];
const unusual = (kind, valueOf) =>
  Object.fromEntries(controls(kind).filter((one) => valueOf(one) !== usualOf(one)).map((one) => [one.dataset.option, valueOf(one)]));

/** The options of a job that differ from the service's defaults, without its time limit. */
const optionsOf = (job) => unusual("select", (one) => String(job[one.dataset.option]));

/** The budget of a picture, and the options that the visitor has changed. kind: null for the service's default. */
export function budget(item) {
  const options = unusual("", (one) => one.value);
  const aim = $("aim").value;
  if (aim === "quality") return isMoved() ? { kind: aim, value: quality(), options } : { kind: null, options };
  if (aim === "size") return { kind: "bytes", value: bytes(item), options };
  return { kind: aim, value: Number($("aim-value").value) || AIMS[aim][1], options };
}

/** The budget of a job, as budget() returns it. Only the default has a max_bpp. */
export function budgetOf(job) {
  const { kind, value, max_bpp } = job.budget;
  return { kind: max_bpp ? null : kind, value, options: optionsOf(job) };
}

/** Describe the slider's value for a picture, or in general. */
export function sayRate(item) {
  const byQuality = $("aim").value === "quality";
  $("rate-name").textContent = byQuality ? "Quality" : "File size";
  const limit = bytes(item);
  if (!isMoved()) $("slider").value = byQuality ? placeOfQuality(USUAL.quality) : placeOf(limit);
  if (byQuality) {
    const most = isMoved() ? "" : `, at most ${USUAL.max_bpp} bits per pixel`;
    $("rate").textContent = `about ${quality()} of 100`;
    $("rate-words").textContent = `SSIMULACRA 2: ${qualityWord(quality())}, in as few bytes as that takes${most}.`;
  } else {
    $("rate").textContent = `at most ${size(limit)}`;
    const less = item?.originalBytes ? `${smaller(item.originalBytes, limit)}, ` : "";
    $("rate-words").textContent = `Estimated: ${less}${expected(limit)}.`;
  }
  $("slider").setAttribute("aria-label", $("rate-name").textContent);
  $("slider").setAttribute("aria-valuetext", $("rate").textContent);
}

export function rememberBudget(changed) {
  for (const control of [$("slider"), $("aim"), ...controls("")]) remembered(control, local);
  remembered($("key"), session);
  $("key-field").hidden = !$("key").value;
  const name = () => `sgmethod-aim-${$("aim").value}`;
  const showAim = () => {
    const aim = AIMS[$("aim").value];
    $("aim-field").hidden = !aim;
    if (!aim) return;
    $("aim-name").textContent = aim[0];
    $("aim-value").value = local[name()] ?? aim[1];
  };
  $("aim").addEventListener("change", () => { showAim(); changed(); });
  $("aim-value").addEventListener("input", () => (local[name()] = $("aim-value").value));
  $("slider").addEventListener("input", changed);
  showAim();
}
