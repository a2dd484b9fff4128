"use strict";

const POLL_MS = 400;
const $ = (id) => document.getElementById(id);
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

function size(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(2)} MB`;
}

async function ask(path, options = {}) {
  const key = $("key").value.trim();
  const response = await fetch(path, key ? { ...options, headers: { Authorization: `Bearer ${key}` } } : options);
  if (response.ok) return response;
  if (response.status === 401) $("key-field").hidden = false;
  throw new Error((await response.json()).detail);
}

const json = async (path, options) => (await ask(path, options)).json();
// An <img> or a link carries no key, so the bytes are fetched here.
const blobUrl = async (path) => URL.createObjectURL(await (await ask(path)).blob());

function say(text, bad = false) {
  $("status").textContent = text;
  $("status").className = bad ? "bad" : "";
}

function choose() {
  const file = $("file").files[0];
  if (!file) return;
  $("name").textContent = `${file.name}, ${size(file.size)}`;
  URL.revokeObjectURL($("original").src);
  $("original").src = URL.createObjectURL(file);
  $("original-size").textContent = `original, ${size(file.size)}`;
  $("decoded").removeAttribute("src");
  $("decoded-size").textContent = "";
  $("download").hidden = true;
  $("pictures").hidden = false;
}

function draw(trace) {
  const points = trace.filter((point) => point.psnr !== null);
  if (points.length < 2) return;
  const psnrs = points.map((point) => point.psnr);
  const [low, high, end] = [Math.min(...psnrs), Math.max(...psnrs), points.at(-1).seconds || 1];
  const place = (p) => `${(600 * p.seconds) / end},${85 - (80 * (p.psnr - low)) / (high - low || 1)}`;
  $("curve").firstElementChild.setAttribute("points", points.map(place).join(" "));
}

function report(job) {
  draw(job.trace);
  if (job.state === "queued") return say(`waiting, place ${job.position} in the queue`);
  if (job.state === "failed") throw new Error(job.error.detail);
  $("progress").value = job.progress;
  const last = job.trace.at(-1);
  if (!last) return say("starting the encoder");
  const psnr = last.psnr === null ? "" : `, ${last.psnr.toFixed(2)} dB`;
  return say(`${last.phase}, step ${last.step} of ${last.steps}${psnr}, ${last.seconds.toFixed(1)} s`);
}

async function show(job) {
  const { bytes, bpp, psnr, gaussians } = job.result;
  const times = (job.image.bytes / bytes).toFixed(0);
  const quality = psnr === null ? "without error" : `${psnr.toFixed(2)} dB`;
  say(`${gaussians} Gaussians, ${bpp.toFixed(3)} bits per pixel, ${quality}`);
  $("decoded").src = await blobUrl(job.decode_url);
  $("decoded-size").textContent = `decoded from ${size(bytes)}, ${times} times smaller`;
  $("download").href = await blobUrl(job.bitstream_url);
  $("download").download = `${job.id}.sg`;
  $("download").hidden = false;
}

async function encode() {
  const form = new FormData();
  form.append("image", $("file").files[0]);
  form.append("bpp", $("bpp").value);
  $("work").hidden = false;
  $("progress").removeAttribute("value");
  $("curve").firstElementChild.setAttribute("points", "");
  say("sending");
  const accepted = await json("/encode", { method: "POST", body: form });
  for (;;) {
    const job = await json(accepted.status_url);
    report(job);
    if (job.state === "done") return show(job);
    await sleep(POLL_MS);
  }
}

$("form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = event.target.querySelector("button");
  button.disabled = true;
  try {
    await encode();
  } catch (error) {
    $("progress").value = 0;
    say(error.message, true);
  } finally {
    button.disabled = false;
  }
});

$("file").addEventListener("change", choose);
for (const kind of ["dragover", "dragleave", "drop"]) {
  $("drop").addEventListener(kind, (event) => {
    event.preventDefault();
    $("drop").classList.toggle("over", kind === "dragover");
    if (kind !== "drop" || event.dataTransfer.files.length === 0) return;
    $("file").files = event.dataTransfer.files;
    choose();
  });
}
const showRate = () => ($("rate").textContent = `${Number($("bpp").value).toFixed(2)} bpp`);
$("bpp").addEventListener("input", showRate);
showRate();
