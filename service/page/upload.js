// Choosing pictures, and the budget of an encode.

import { local, remembered, session } from "./storage.js";
import { $ } from "./parts.js";
import { expected, size, smaller } from "./words.js";

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

/** The slider's bits per pixel: 0.05 to 2, each step 3.8 % more. */
const rate = () => Number((0.05 * 40 ** ($("bpp").value / 100)).toFixed(3));

/** SSIMULACRA 2, 5 to 95. */
const quality = () => Math.round(5 + 0.9 * Number($("bpp").value));
const QUALITIES = [[80, "hardly different from the original"], [60, "good beside the original"], [30, "good on its own"], [0, "a preview"]];

export function budget() {
  const timeLimit = Number($("time-limit").value) || null;
  const kind = $("aim").value;
  const value = kind === "bpp" ? rate() : kind === "quality" ? quality() : Number($("aim-value").value) || AIMS[kind][1];
  return { kind, value, tune: $("tune").value, effort: Number($("effort").value), timeLimit };
}

/** Describe the slider's value for a picture, or in general. */
export function sayRate(item) {
  const byQuality = $("aim").value === "quality";
  $("rate-name").textContent = byQuality ? "How good" : "File size";
  $("bpp").setAttribute("aria-label", $("rate-name").textContent);
  if (byQuality) {
    $("rate").textContent = `${quality()} of 100`;
    $("bpp").setAttribute("aria-valuetext", $("rate").textContent);
    $("rate-words").textContent = `SSIMULACRA 2, ${QUALITIES.find(([least]) => quality() >= least)[1]}, in as few bytes as that takes.`;
    return;
  }
  const bpp = rate();
  if (item?.size && item.originalBytes) {
    const bytes = Math.round((bpp * item.size[0] * item.size[1]) / 8);
    $("rate").textContent = `about ${size(bytes)}`;
    $("rate-words").textContent = `Estimated: ${smaller(item.originalBytes, bytes)}, ${expected(bytes)}.`;
  } else {
    $("rate").textContent = `${size(Math.round((bpp / 8) * 1e6))} a megapixel`;
    $("rate-words").textContent = `${bpp.toFixed(2)} bits per pixel.`;
  }
  $("bpp").setAttribute("aria-valuetext", $("rate").textContent);
}

export function rememberBudget(changed) {
  for (const id of ["bpp", "aim", "tune", "effort", "time-limit"]) remembered($(id), local);
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
  $("bpp").addEventListener("input", changed);
  showAim();
}
