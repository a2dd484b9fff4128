// The page: a photograph, its previews beside other placeholders, and the same photograph as an .sg file.

import "../src/sg-img.js";
import { newStage } from "./stage.js";
import { startWorker } from "./work.js";

const SIZES = [64, 100, 150, 200, 300, 400, 500, 700, 1000]; // bytes of a preview
const [FIRST_SIZE, KILOBYTES, FIRST_KILOBYTES] = [3, [2, 4, 8, 12], 4];
const SAMPLES = ["cat", "astronaut", "coffee"];
const WAIT_MS = 120; // of a slider, before placeholders follow it

const $ = (id) => document.getElementById(id);
const maker = startWorker(); // reads the photograph, and makes what is small
let filer = null; // makes a file, which takes seconds; ended when nobody needs it any more
const stage = newStage(startWorker(), $("stage"), $("canvas"));
const tiles = {};
let photograph = null; // { blob, name, width, height }
let file = null; // the bytes of the .sg file that is shown
let ready = null; // the one that came with the photograph
let name = ""; // of what was chosen
let opened = 0; // photographs and files so far
let timer = 0;

function complain(error) {
  $("trouble").textContent = error.message;
  $("trouble").hidden = false;
  setTimeout(() => ($("trouble").hidden = true), 8000);
}

/** What an event begins; what goes wrong is said, unless something newer has begun. */
const doing =
  (task) =>
  (...given) =>
    Promise.resolve(task(...given)).catch((error) => {
      if (error.isStale) return;
      setBusy(false);
      setWorking("");
      complain(error);
    });

function addTile(name, title, words = "") {
  const [figure, shown, caption, bold] = ["figure", "div", "figcaption", "b"].map((tag) => document.createElement(tag));
  figure.className = name === "ours" ? "ours" : "";
  shown.className = "shown";
  bold.textContent = title;
  const note = document.createElement("span");
  note.textContent = words;
  caption.append(bold, " ", note);
  figure.append(shown, caption);
  $("tiles").append(figure);
  tiles[name] = { shown, note };
}

function fill(name, content, words) {
  tiles[name].shown.replaceChildren(content);
  tiles[name].note.textContent = words;
  tiles[name].shown.ariaBusy = null;
}

function setBusy(isBusy) {
  const places = [...Object.values(tiles).map(({ shown }) => shown), $("text"), $("element")];
  for (const one of places) one.ariaBusy = isBusy ? "true" : null;
}

function setWorking(words) {
  $("working").textContent = words;
  $("working").hidden = !words;
}

/** Forget what was shown, and say what is done about the next; nothing if there is none. */
function clear(words = "") {
  filer?.stop();
  maker.forget();
  photograph = file = ready = null;
  for (const one of Object.keys(tiles)) fill(one, said(["photograph", "ours"].includes(one) ? words : ""), "");
  $("text").value = $("element").textContent = $("file-words").textContent = "";
  $("save").disabled = true;
  stage.setPhotograph(null);
  setBusy(Boolean(words));
  setWorking(words);
  return ++opened;
}

/** Wait for a part of what is to be shown; where that fails, there is nothing to show. */
const orNothing = (promise) =>
  promise.catch((error) => {
    if (!error.isStale) clear();
    throw error;
  });

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

function canvasOf({ data, width, height }) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  canvas.getContext("2d").putImageData(new ImageData(data, width, height), 0, 0);
  return canvas;
}

const chars = (count) => `${count.toLocaleString("en")} characters`;
const sizeOf = (bytes) => `${bytes.toLocaleString("en")} bytes`;
const bytes = () => SIZES[$("bytes").value];

function showSize() {
  const characters = Math.ceil((4 * (bytes() - 1)) / 3);
  $("size-words").textContent = `${sizeOf(bytes())}: ${chars(characters)}`;
  $("bytes").ariaValueText = $("size-words").textContent;
}

/** Make the preview, and then what is as long. */
async function showPreviews() {
  setBusy(true);
  tiles.photograph.shown.ariaBusy = null;
  for (const made of ["ours", "webp", "blurhash", "thumbhash"]) tiles[made].note.textContent = "";
  const before = performance.now();
  const { text, bytes: small } = await maker.ask("preview", { bytes: bytes() });
  const seconds = (performance.now() - before) / 1000;
  const one = Object.assign(document.createElement("sg-img"), { preview: text, alt: "The preview" });
  fill("ours", one, `${chars(text.length)}, made in ${seconds.toFixed(1)} s`);
  $("text").value = text;
  $("text").ariaBusy = $("element").ariaBusy = null;
  $("element").textContent = `<script type="module" async src="sg-img.js"></script>
<link rel="stylesheet" href="sg-img.css">
<sg-img preview="${text}">
  <img src="${name}" alt="" width="${photograph.width}" height="${photograph.height}" loading="lazy">
</sg-img>`;
  if (!file && !ready) doing(stage.show)(small); // until there is a larger one
  const characters = text.length;
  const { blob, length } = await maker.ask("webp", { characters });
  if (blob) fill("webp", imgOf(blob, "WebP"), chars(length));
  else fill("webp", said(length ? "No file is that small." : "This browser makes no WebP."), "");
  const blurred = await maker.ask("blurhash", { characters });
  fill("blurhash", canvasOf(blurred), chars(blurred.text.length));
  const thumb = await maker.ask("thumbhash", {});
  fill("thumbhash", canvasOf(thumb), chars(thumb.text.length));
}

async function showFile(bytes, words) {
  await stage.show(bytes);
  file = bytes;
  $("file-words").textContent = `${sizeOf(bytes.length)}${words}`;
  $("save").disabled = false;
}

/** Make the .sg file of the photograph, or take the one of a sample. */
async function makeFile(given) {
  filer?.stop();
  setWorking("");
  $("save").disabled = true;
  if (given) return showFile(given, ", made by the Python package, whose encoder gets more out of a file than this page’s.");
  const limit = 1000 * $("kilobytes").value;
  filer = startWorker();
  setWorking(`Making a file of ${sizeOf(limit)}, which takes up to half a minute`);
  const began = performance.now();
  await filer.ask("open", { blob: photograph.blob });
  const made = await filer.ask("file", { bytes: limit });
  setWorking("");
  await showFile(made, `, made here in ${((performance.now() - began) / 1000).toFixed(1)} s. The Python package is faster, and its files are better.`);
}

async function open(blob, given = null) {
  clear(`Reading ${name}`);
  const size = await orNothing(maker.ask("open", { blob }));
  photograph = { blob, ...size };
  document.documentElement.style.setProperty("--ratio", `${size.width} / ${size.height}`);
  const img = imgOf(blob, "The photograph");
  fill("photograph", img, `${size.width} × ${size.height}, ${sizeOf(blob.size)}`);
  stage.setPhotograph(img);
  fill("ours", said("Making the preview"), "");
  ready = given;
  $("kilobytes").options[0].hidden = !ready;
  $("kilobytes").value = ready ? "" : FIRST_KILOBYTES;
  await Promise.all([doing(showPreviews)(), ready && makeFile(ready)]);
  if (!given && photograph?.blob === blob) await makeFile(); // last, since it takes all of a core for seconds
}

async function openSample(sample) {
  const mine = clear(`Loading ${sample}.webp`);
  const [picture, sg] = await orNothing(Promise.all(["webp", "sg"].map((kind) => fetch(`samples/${sample}.${kind}`))));
  const [blob, bytes] = [await picture.blob(), new Uint8Array(await sg.arrayBuffer())];
  if (mine !== opened) return; // something else was chosen meanwhile
  name = `${sample}.webp`;
  await open(blob, bytes);
}

async function openFiles([given]) {
  if (!given) return;
  for (const button of $("samples").children) button.ariaPressed = "false";
  name = given.name;
  if (!name.endsWith(".sg")) return open(given);
  clear();
  fill("photograph", said("A file, which is shown below"), "");
  await orNothing(given.arrayBuffer().then((data) => showFile(new Uint8Array(data), `: ${given.name}`)));
  $("stage").scrollIntoView();
}

function showSnippet() {
  for (const one of document.querySelectorAll(".snippet")) one.hidden = one.id !== $("framework").value;
}

async function copy(button) {
  await navigator.clipboard.writeText($(button.dataset.copies).value ?? $(button.dataset.copies).textContent);
  const words = button.textContent;
  $("said").textContent = button.textContent = "Copied";
  setTimeout(() => (button.textContent = words), 1500);
}

function save() {
  const download = `${name.replace(/\.\w+$/, "")}.sg`;
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(new Blob([file])), download });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function listen() {
  $("file").addEventListener("change", doing(() => openFiles($("file").files)));
  addEventListener("paste", doing(({ clipboardData }) => openFiles(clipboardData.files)));
  for (const kind of ["dragenter", "dragover", "dragleave", "drop"]) {
    addEventListener(kind, (event) => {
      event.preventDefault();
      document.body.classList.toggle("dropping", kind === "dragenter" || kind === "dragover");
    });
  }
  addEventListener("drop", doing(({ dataTransfer }) => openFiles(dataTransfer.files)));
  for (const button of $("samples").children) {
    button.addEventListener("click", doing(() => {
      for (const other of $("samples").children) other.ariaPressed = String(other === button);
      return openSample(button.dataset.sample);
    }));
  }
  $("bytes").addEventListener("input", () => {
    showSize();
    clearTimeout(timer);
    timer = setTimeout(doing(() => {
      maker.forget();
      return photograph && showPreviews();
    }), WAIT_MS);
  });
  $("framework").addEventListener("change", showSnippet);
  for (const button of document.querySelectorAll("[data-copies]")) button.addEventListener("click", doing(() => copy(button)));
  $("kilobytes").addEventListener("change", doing(() => photograph && makeFile($("kilobytes").value ? null : ready)));
  $("save").addEventListener("click", save);
  $("zoom-in").addEventListener("click", () => stage.zoom(1.5));
  $("zoom-out").addEventListener("click", () => stage.zoom(1 / 1.5));
  $("zoom-fit").addEventListener("click", () => stage.fit());
  $("compare").addEventListener("click", () => {
    const isPressed = $("compare").ariaPressed !== "true";
    $("compare").ariaPressed = String(isPressed);
    stage.compare(isPressed);
  });
}

Object.assign($("bytes"), { min: 0, max: SIZES.length - 1, step: 1, value: FIRST_SIZE });
$("kilobytes").append(new Option("as it came", ""), ...KILOBYTES.map((count) => new Option(`${count},000 bytes`, count)));
addTile("photograph", "Photograph");
addTile("ours", "sgmethod");
addTile("webp", "WebP");
addTile("blurhash", "BlurHash");
addTile("thumbhash", "ThumbHash");
showSize();
showSnippet();
listen();
$("samples").children[SAMPLES.indexOf("cat")].click();
