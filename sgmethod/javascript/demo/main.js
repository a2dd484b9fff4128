// The page: a photograph, its preview beside a WebP of the same length, and the HTML that shows it.

import "../src/sg-img.js";

const SIZES = [64, 100, 150, 200, 300, 400, 500, 700, 1000]; // bytes of a preview
const FIRST_SIZE = 3;
const WAIT_MS = 120; // of a slider, before the previews follow it

const $ = (id) => document.getElementById(id);
const worker = new Worker("worker.js", { type: "module" });
const asked = new Map(); // questions to the worker that somebody waits for
let count = 0; // of questions so far
let photograph = null; // { name, width, height }
let opened = 0; // photographs so far
let timer = 0;

worker.addEventListener("message", ({ data: { call, answer, error } }) => {
  const { resolve, reject } = asked.get(call) ?? {}; // those forgotten have none
  asked.delete(call);
  if (error) reject?.(new Error(error));
  else resolve?.(answer);
});

function ask(name, given) {
  return new Promise((resolve, reject) => {
    asked.set(++count, { resolve, reject });
    worker.postMessage({ call: count, name, given });
  });
}

/** What an event begins; what goes wrong is said. */
const doing =
  (task) =>
  (...given) =>
    Promise.resolve(task(...given)).catch((error) => {
      clear();
      $("trouble").textContent = error.message;
      $("trouble").hidden = false;
      setTimeout(() => ($("trouble").hidden = true), 8000);
    });

function fill(tile, content, words) {
  $(tile).replaceChildren(content);
  $(tile).parentElement.querySelector("span").textContent = words;
  $(tile).ariaBusy = null;
}

function setBusy(isBusy) {
  for (const one of ["ours", "webp", "text", "element"]) $(one).ariaBusy = isBusy ? "true" : null;
}

/** Forget what was shown, and say what is done about the next; nothing if there is none. */
function clear(words = "") {
  asked.clear();
  photograph = null;
  for (const one of ["photograph", "ours", "webp"]) fill(one, said(one === "webp" ? "" : words), "");
  $("text").value = $("element").textContent = "";
  setBusy(Boolean(words));
  return ++opened;
}

function said(words) {
  const p = document.createElement("p");
  p.textContent = words;
  return p;
}

function imgOf(blob, alt) {
  const img = new Image();
  img.addEventListener("load", () => URL.revokeObjectURL(img.src));
  return Object.assign(img, { src: URL.createObjectURL(blob), alt });
}

const chars = (number) => `${number.toLocaleString("en")} characters`;
const sizeOf = (bytes) => `${bytes.toLocaleString("en")} bytes`;
const bytes = () => SIZES[$("bytes").value];

function showSize() {
  $("size-words").textContent = `${sizeOf(bytes())}: ${chars(Math.ceil((4 * (bytes() - 1)) / 3))}`;
  $("bytes").ariaValueText = $("size-words").textContent;
}

/** Make the preview, and then a WebP that is as long. */
async function showPreviews() {
  asked.clear();
  setBusy(true);
  const before = performance.now();
  const text = await ask("preview", { bytes: bytes() });
  const seconds = (performance.now() - before) / 1000;
  const one = Object.assign(document.createElement("sg-img"), { preview: text, alt: "The preview" });
  fill("ours", one, `${chars(text.length)}, made in ${seconds.toFixed(1)} s`);
  $("text").value = text;
  const { name, width, height } = photograph;
  $("element").textContent = `<script type="module" async src="sg-img.js"></script>
<link rel="stylesheet" href="sg-img.css">
<sg-img preview="${text}">
  <img src="${name}" alt="" width="${width}" height="${height}" loading="lazy">
</sg-img>`;
  $("text").ariaBusy = $("element").ariaBusy = null;
  const { blob, length } = await ask("webp", { characters: text.length });
  if (blob) fill("webp", imgOf(blob, "WebP"), chars(length));
  else fill("webp", said(length ? "No file is that small." : "This browser makes no WebP."), "");
}

async function open(blob, name) {
  clear(`Reading ${name}`);
  const size = await ask("open", { blob });
  photograph = { name, ...size };
  document.documentElement.style.setProperty("--ratio", `${size.width} / ${size.height}`);
  fill("photograph", imgOf(blob, "The photograph"), `${size.width} × ${size.height}, ${sizeOf(blob.size)}`);
  fill("ours", said("Making the preview"), "");
  await showPreviews();
}

async function openSample(button) {
  for (const other of $("samples").children) other.ariaPressed = String(other === button);
  const name = `${button.textContent}.webp`;
  const mine = clear(`Loading ${name}`);
  const blob = await (await fetch(`samples/${name}`)).blob();
  if (mine === opened) await open(blob, name); // else something else was chosen meanwhile
}

async function openFiles([given]) {
  if (!given) return;
  for (const button of $("samples").children) button.ariaPressed = "false";
  await open(given, given.name);
}

async function copy(button) {
  const shown = $(button.dataset.copies);
  await navigator.clipboard.writeText(shown.value ?? shown.textContent);
  const words = button.textContent;
  $("said").textContent = button.textContent = "Copied";
  setTimeout(() => (button.textContent = words), 1500);
}

$("file").addEventListener("change", doing(() => openFiles($("file").files)));
addEventListener("paste", doing(({ clipboardData }) => openFiles(clipboardData.files)));
for (const kind of ["dragenter", "dragover", "dragleave", "drop"]) {
  addEventListener(kind, (event) => {
    event.preventDefault();
    document.body.classList.toggle("dropping", kind === "dragenter" || kind === "dragover");
  });
}
addEventListener("drop", doing(({ dataTransfer }) => openFiles(dataTransfer.files)));
for (const button of $("samples").children) button.addEventListener("click", doing(() => openSample(button)));
for (const button of document.querySelectorAll("[data-copies]")) button.addEventListener("click", () => copy(button));
$("bytes").addEventListener("input", () => {
  showSize();
  clearTimeout(timer);
  timer = setTimeout(doing(() => photograph && showPreviews()), WAIT_MS);
});
Object.assign($("bytes"), { min: 0, max: SIZES.length - 1, step: 1, value: FIRST_SIZE });
showSize();
$("samples").children[0].click();
