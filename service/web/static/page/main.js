// The page: what is shown, and what happens when something is clicked.

import { countInPart } from "../decoder/file.js";
import { openGpu } from "../viewer/gpu.js";
import { heatOf, heatPicture } from "../viewer/overlays.js";
import { fillTable, measure } from "../viewer/rivals.js";
import { Viewer } from "../viewer/viewer.js";
import { budget, listen, rememberBudget, sayRate } from "./giving.js";
import { draw, Item } from "./items.js";
import { kindOf } from "./kinds.js";
import { $, Remote } from "./parts.js";
import { openSample, SAMPLES, showSamples } from "./samples.js";
import { fillLines, linkOf, saveFile, savePicture, snippetOf } from "./taking.js";
import { showLabels, showRows, showWork, trouble } from "./telling.js";
import { count, size, withoutSuffix } from "./words.js";

const UNFOLD_MS = 1400;

const items = []; // in the order in which they came
let current = null;
let onLeft = "Original";

const viewer = new Viewer($("stage"), $("canvas"), $("divider"), { draw, changed: showZoom });

// What is shown

function show(item) {
  current = item;
  onLeft = "Original";
  $("prefix").value = 100;
  item.drawn = null;
  refresh(item);
}

function changed(item) {
  if (!items.includes(item)) return;
  tellRows();
  if (item === current) refresh(item);
}

/** Bring everything up to date with the picture that is shown. */
function refresh(item) {
  const { original, decoded, file } = item;
  const left = onLeft === "Original" ? original : item.rivals?.[onLeft]?.image;
  const isNew = item.drawn?.decoded !== decoded || item.drawn?.original !== original;
  Object.assign(viewer, { left: left ?? null, right: decoded, file });
  if (isNew) {
    item.drawn = { decoded, original };
    viewer.count = file?.count ?? 0;
    $("prefix").value = 100;
    if (item.size) viewer.show(...item.size);
    if (decoded) {
      history.replaceState(null, "", item.id ? `#${item.id}` : item.sample ? `#${item.sample}` : "#");
      $("width").value = item.size[0];
      fillLines(item);
      if (original && !item.isMeasured) measure(item, () => changed(item));
      item.isMeasured = Boolean(original);
      if (item.watched) unfold(item);
      item.watched = false;
    }
  }
  viewer.redraw();
  tellLabels(item);
  showWork(item);
  fillTable(item, onLeft, (name) => {
    onLeft = name;
    refresh(item);
  });
  for (const id of ["smooth", "prefix"]) $(id).disabled = !file;
  for (const input of document.querySelectorAll("[name=overlay]")) input.disabled = !file;
  $("prefix-field").hidden = !file;
  $("take-card").hidden = !decoded;
  $("snippet").hidden = !file;
  $("link").hidden = !item.id && !item.sample;
  $("again").hidden = !item.source || item.busy || Boolean(item.sample && !decoded);
  $("again").textContent = item.sample ? "Encode this one" : "Encode again";
  showOverlay();
  showPrefix();
  sayRate(item);
}

function tellLabels(item) {
  const isPart = item.file && $("prefix").value < 100;
  showLabels(item, onLeft, Boolean(viewer.left), isPart ? bytesInPart(item.file) : 0);
}

function showZoom() {
  $("zoom").textContent = `${Math.round(100 * viewer.zoom)} %`;
}

const bytesInPart = (file) => Math.ceil(($("prefix").value / 100) * (file.bytes - file.start)) + file.start;

function showPrefix() {
  const { file } = viewer;
  if (!file) return;
  const part = $("prefix").value / 100;
  viewer.count = countInPart(file, part);
  const gaussians = `${count(viewer.count)} Gaussians`;
  $("prefix-words").textContent = part < 1 ? `${size(bytesInPart(file))}, ${gaussians}` : `all ${gaussians}`;
  viewer.redraw();
}

/** Play a file that has just been made, from its first bytes to its last. */
function unfold(item) {
  if (!item.file || !viewer.gpu || matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  const began = performance.now();
  const frame = (now) => {
    const part = Math.min(Math.max(now - began, 0) / UNFOLD_MS, 1);
    if (item !== current) return;
    $("prefix").value = Math.max(1, 100 * part * part);
    showPrefix();
    if (part < 1) requestAnimationFrame(frame);
    else tellLabels(item);
  };
  requestAnimationFrame(frame);
}

function showOverlay() {
  const overlay = document.querySelector("[name=overlay]:checked").value;
  viewer.overlay = overlay;
  viewer.smooth = $("smooth").checked;
  const { file } = viewer;
  if (overlay === "heat" && file && !file.heat) file.heat = heatOf(file);
  viewer.heat = file?.heat ? (file.heat.picture ??= heatPicture(file.heat)) : null;
  const most = file?.heat?.most.toFixed(1);
  $("legend").textContent = {
    none: "",
    ellipses: "Each ellipse is a Gaussian at one standard deviation. Orange ones add light, blue ones take it away.",
    heat: `Where the bits went: dark is none, pale yellow ${most} bits per pixel and more.`,
  }[file ? overlay : "none"];
  $("legend").hidden = !$("legend").textContent;
  viewer.redraw();
}

function tellRows() {
  const pick = (item) => {
    show(item);
    tellRows();
  };
  showRows(items, current, pick, remove);
}

function remove(item) {
  if (item.busy) item.cancel();
  items.splice(items.indexOf(item), 1);
  item.close();
  if (item === current && items.length) show(items.at(-1));
  tellRows();
}

// What happens

function added(name) {
  const item = new Item(name, changed);
  items.push(item);
  return item;
}

async function sample(name) {
  let item = items.find((one) => one.sample === name);
  if (!item) {
    item = added(`${name}.webp`);
    item.sample = name;
    show(item);
    await openSample(item, name).catch((error) => trouble(error.message));
  }
  show(item);
  tellRows();
}

async function give(files) {
  trouble("");
  for (const [place, file] of files.entries()) {
    const { kind, refused } = await kindOf(file);
    if (refused) {
      trouble(refused);
      continue;
    }
    // What nobody gave makes room: the sample that the page began with.
    const first = items.findIndex((item) => item.sample);
    if (first >= 0) items.splice(first, 1)[0].close();
    const item = added(file.name || "pasted.png");
    if (place === 0 || !current || !items.includes(current)) show(item);
    try {
      if (kind === "sg") await item.setFile(new Uint8Array(await file.arrayBuffer()));
      else {
        await item.setOriginal(file);
        if (place === 0) show(item);
        item.encode(budget());
      }
    } catch (error) {
      item.tell({ state: "failed", words: `${item.name} cannot be opened: ${error.message}.` });
    }
  }
  tellRows();
}

async function again() {
  const item = added(current.name);
  const { source, sample: name } = current;
  await item.setOriginal(source);
  if (name) item.name = `${withoutSuffix(current.name)}.webp`;
  show(item);
  item.encode(budget());
}

async function begin() {
  const wanted = location.hash.slice(1);
  if (/^[0-9a-f]{32}$/.test(wanted)) {
    const known = items.find((item) => item.id === wanted);
    const item = known ?? added("photograph");
    show(item);
    if (!known) item.resume(wanted);
  } else await sample(SAMPLES.includes(wanted) ? wanted : SAMPLES[0]);
}

async function copied(making, words) {
  try {
    const text = await making();
    await navigator.clipboard.writeText(text);
    $("taken").textContent = `${words} (${size(text.length)}) is in the clipboard.`;
  } catch (error) {
    $("taken").textContent = `That did not work: ${error.message}`;
  }
}

listen(give);
rememberBudget(() => sayRate(current));
$("again").addEventListener("click", again);
$("key-field").addEventListener("submit", (event) => {
  event.preventDefault();
  if (current.state !== "failed") return;
  if (current.id) current.resume(current.id);
  else if (current.source) current.encode(budget());
});
$("cancel").addEventListener("click", () => current.cancel());
$("zoom-in").addEventListener("click", () => viewer.zoomTo(viewer.zoom * 2));
$("zoom-out").addEventListener("click", () => viewer.zoomTo(viewer.zoom / 2));
$("zoom-fit").addEventListener("click", () => viewer.fit());
$("smooth").addEventListener("change", showOverlay);
$("prefix").addEventListener("input", () => {
  showPrefix();
  tellLabels(current);
});
for (const input of document.querySelectorAll("[name=overlay]")) input.addEventListener("change", showOverlay);
$("save-sg").addEventListener("click", () => saveFile(current));
$("save-picture").addEventListener("click", async () => {
  $("taken").textContent = "Drawing";
  try {
    await savePicture(current, $("kind").value, Number($("width").value) || current.size[0], draw);
    $("taken").textContent = "";
  } catch (error) {
    $("taken").textContent = `That did not work: ${error.message}`;
  }
});
$("link").addEventListener("click", () => copied(() => linkOf(current), "The link"));
$("snippet").addEventListener("click", () => copied(() => snippetOf(current), "The HTML"));

const peek = (side) => {
  viewer.peek = side;
  viewer.redraw();
};
$("blink").addEventListener("pointerdown", () => peek(1));
for (const kind of ["pointerup", "pointerleave", "blur"]) $("blink").addEventListener(kind, () => peek(null));
const isBlink = ({ key, ctrlKey, metaKey, target }) =>
  key.toLowerCase() === "b" && !ctrlKey && !metaKey && !target.matches("select, input:not([type=range], [type=radio])");
addEventListener("keydown", (event) => isBlink(event) && !event.repeat && peek(viewer.peek === 1 ? 0 : 1));
addEventListener("keyup", (event) => isBlink(event) && peek(null));
addEventListener("hashchange", begin);

/** Once the empty page has been painted, which WebGL and workers would hold up. */
requestAnimationFrame(() =>
  setTimeout(() => {
    begin();
    const thumbnails = new Remote("/static/decoder/worker.js");
    showSamples(sample, async (bytes) => {
      await thumbnails.ask("open", { key: 0, bytes });
      return thumbnails.ask("draw", { key: 0, scale: 0.5 });
    });
    viewer.gpu = openGpu();
    viewer.redraw();
  }),
);
