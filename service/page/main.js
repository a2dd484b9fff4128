// The page: its pictures, and its buttons.

import { fillTable, measure } from "./viewer/comparisons.js";
import { Tools } from "./viewer/tools.js";
import { Viewer } from "./viewer/viewer.js";
import { budget, listen, rememberBudget, sayRate } from "./upload.js";
import { draw, imageOf, Item } from "./items.js";
import { $, element, Remote } from "./parts.js";
import { openSample, SAMPLES, showSamples, THUMBNAIL_WIDTH } from "./samples.js";
import { fillLines, linkOf, offerWidths, saveFile, savePicture } from "./download.js";
import { TITLES, showLabels, showRows, showWork, trouble } from "./status.js";

const items = []; // in the order in which they came
let current = null;
let entered = null; // the picture in the address
let address = location.hash.slice(1); // as far as the page has followed it
let onLeft = "Original";

const viewer = new Viewer($("stage"), $("canvas"), $("divider"), draw);
const tools = new Tools(viewer, () => refresh(current));

// What is shown

function show(item) {
  current = item;
  onLeft = "Original";
  item.drawn = null;
  $("taken").textContent = "";
  refresh(item);
}

function changed(item) {
  if (!items.includes(item)) return;
  refreshRows();
  if (item === current) refresh(item);
}

/** Update the page for the current picture. */
function refresh(item) {
  const { original, decoded, file } = item;
  const isNewlyDecoded = item.drawn?.decoded !== decoded;
  const isNew = isNewlyDecoded || item.drawn?.original !== original;
  const isSmooth = Boolean(file?.texture) && !tools.textured;
  enter(item);
  viewer.left = (onLeft === "Original" ? original : item.others?.[onLeft]?.image) ?? null;
  viewer.right = isSmooth ? smoothOf(item) : decoded;
  if (isNew) {
    item.drawn = { decoded, original, isFitted: false };
    tools.whole();
  }
  if (item.size && !item.drawn.isFitted) {
    item.drawn.isFitted = true;
    viewer.show(...item.size);
  }
  tools.refresh(file);
  if (isNew && decoded) {
    if (isNewlyDecoded) offerWidths(item.size); // once: a width may be typed since
    fillLines(item);
    if (original && !item.isMeasured) measure(item, () => changed(item));
    item.isMeasured = Boolean(original);
  }
  const hasNothing = !viewer.left && !viewer.right && item.state in TITLES;
  $("stage").hidden = $("tools").hidden = hasNothing;
  showLabels(item, onLeft, Boolean(viewer.left), tools.part, isSmooth);
  showWork(item);
  $("advice").hidden = !decoded || !item.job?.result?.better;
  if (!$("advice").hidden) import("./viewer/better.js").then(({ showAdvice }) => showAdvice(current));
  fillTable(item, onLeft, (name) => {
    onLeft = name;
    refresh(item);
  });
  $("take-card").hidden = !decoded;
  $("link").hidden = !item.id && !item.sample;
  $("again").hidden = !item.source || item.busy || item.refused || Boolean(item.sample && !decoded);
  $("again").classList.toggle("button", !item.sample);
  $("again").textContent = item.sample ? "Encode this sample again" : item.isUnread ? "Send it anyway" : "Encode again";
  sayRate(item);
}

/** Put the picture into the address, for reloading and going back. */
function enter(item) {
  if (!item.place || location.hash.slice(1) !== address) return; // the user is going elsewhere
  if (address !== item.place) {
    history[!entered || entered === item ? "replaceState" : "pushState"](null, "", `#${item.place}`);
    address = item.place;
  }
  entered = item;
}

/** The picture without its texture; with it until the other is drawn. */
function smoothOf(item) {
  if (!item.smooth) {
    item.smooth = item.decoded; // until then
    draw(item.file, { scale: 1, texture: false })
      .then(imageOf)
      .then((image) => item.update({ smooth: image }));
  }
  return item.smooth;
}

function refreshRows() {
  const pick = (item) => {
    show(item);
    refreshRows();
  };
  showRows(items, current, pick, remove);
}

function remove(item) {
  if (item.busy) item.cancel(Boolean(item.source)); // a job of another person goes on
  items.splice(items.indexOf(item), 1);
  if (item === current && items.length) show(items.at(-1));
  if (item !== current) item.close();
  refreshRows();
}

// What happens

function added(name) {
  const item = new Item(name, changed);
  items.push(item);
  return item;
}

function sample(name) {
  const item = items.find((one) => one.sample === name) ?? added(`${name}.webp`);
  item.sample = name;
  show(item);
  refreshRows();
  item.opening ??= openSample(item, name).catch((error) => {
    item.opening = null; // the next click tries again
    trouble(error.message);
  });
}

async function give(files) {
  const refusals = [];
  let shown = false;
  trouble("");
  const { COMMON, kindOf } = await import("./kinds.js");
  for (const file of files) {
    const { kind, format, refused } = await kindOf(file).catch(() => ({ refused: `${file.name} cannot be read.` }));
    if (refused) {
      refusals.push(refused);
      trouble(refusals.join(" "));
      continue;
    }
    // A sample makes way for a picture of the user's own.
    const first = items.findIndex((item) => item.sample);
    const removed = first >= 0 ? items.splice(first, 1)[0] : null;
    const item = added(file.name || "pasted.png");
    item.format = format;
    if (!shown || !items.includes(current)) show(item);
    shown = true;
    removed?.close();
    try {
      if (kind === "sg") await item.open(file);
      else {
        await item.setOriginal(file);
        if (!item.original && COMMON.includes(format)) {
          const words = `This ${format} is damaged, or too large for this browser.`;
          item.update({ state: "failed", words, isUnread: true });
        } else if (items.includes(item)) item.encode(budget(item));
      }
    } catch (error) {
      item.update({ state: "failed", words: `The file cannot be opened: ${error.message}` });
    }
  }
  refreshRows();
}

async function again() {
  const item = added(current.name);
  const { source, format } = current;
  item.format = format;
  item.state = "sending"; // so that a second click has no effect
  show(item);
  await item.setOriginal(source);
  if (item.busy) item.encode(budget(item));
}

/** Show the picture in the address. */
function begin() {
  const wanted = location.hash.slice(1);
  address = wanted;
  const known = items.find((item) => item.place === wanted);
  if (!wanted || SAMPLES.includes(wanted)) sample(wanted || SAMPLES[0]);
  else if (known) {
    show(known);
    refreshRows();
  } else if (/^[0-9a-f]{32}$/.test(wanted)) {
    const item = added("photograph");
    item.id = wanted;
    show(item);
    item.resume(wanted);
  } else if (wanted.startsWith("file-")) {
    const item = added("file.sg");
    show(item);
    item.reopen(wanted);
  } else {
    const item = added("photograph");
    show(item);
    item.update({ state: "failed", words: "No picture has this address: it may have been cut off." });
  }
}

/** Copy to the clipboard, also on pages loaded by plain HTTP. */
async function copy(text) {
  if (navigator.clipboard) return navigator.clipboard.writeText(text);
  const area = element("textarea", { value: text });
  document.body.append(area);
  area.select();
  const isDone = document.execCommand("copy");
  area.remove();
  if (!isDone) throw new Error("this browser does not let pages copy.");
}

/** Export something of the picture shown, and report the outcome. */
async function take(task) {
  $("taken").textContent = "";
  const item = current;
  const words = await task(item).catch((error) => `That did not work: ${error.message}`);
  if (item === current) $("taken").textContent = words;
}

async function copyLink(item) {
  await copy(await linkOf(item));
  return "The link is in the clipboard.";
}

listen(give);
rememberBudget(() => sayRate(current));
$("again").addEventListener("click", again);
$("key-field").addEventListener("submit", (event) => {
  event.preventDefault();
  if (current.state !== "failed") return;
  if (current.id) current.resume(current.id);
  else if (current.source) current.encode(budget(current));
});
$("cancel").addEventListener("click", () => current.cancel());
$("save-sg").addEventListener("click", () => take(saveFile));
$("save-picture").addEventListener("click", () =>
  take((item) => savePicture(item, $("kind").value, Number($("width").value) || item.size[0], draw)),
);
$("link").addEventListener("click", () => take(copyLink));
addEventListener("hashchange", begin);

/** Start after the empty page has been painted, which workers would delay. */
requestAnimationFrame(() =>
  setTimeout(() => {
    begin();
    const thumbnails = new Remote("static/decoder_worker.js");
    showSamples(sample, async (bytes) => {
      const { width } = await thumbnails.ask("open", { key: 0, bytes });
      return thumbnails.ask("draw", { key: 0, scale: THUMBNAIL_WIDTH / width });
    });
  }),
);
