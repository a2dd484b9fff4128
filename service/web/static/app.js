"use strict";

const POLL_MS = 400;
const RETRY_MS = 2000;
const RETRIES = 30;
const $ = (id) => document.getElementById(id);
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** What came in place of what was asked for. */
class Refusal extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

function size(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(2)} MB`;
}

async function ask(path, options = {}) {
  const key = $("key").value.trim();
  if (key) options = { ...options, headers: { Authorization: `Bearer ${key}` } };
  const response = await fetch(path, options).catch(() => {
    throw new Refusal(503, "the service cannot be reached");
  });
  if (response.ok) return response;
  if (response.status === 401) {
    $("key-field").hidden = false;
    $("key").focus();
    throw new Refusal(401, key ? "this API key is not known here" : "this service needs an API key");
  }
  const problem = await response.json().catch(() => ({})); // a proxy's answer may be anything
  throw new Refusal(response.status, problem.detail ?? `the service answers with status ${response.status}`);
}

const json = async (path, options) => (await ask(path, options)).json();
// An <img> or a link carries no key, so the bytes are fetched here.
const blobUrl = async (path) => URL.createObjectURL(await (await ask(path)).blob());

function say(text, bad = false) {
  $("status").textContent = text;
  $("status").className = bad ? "bad" : "";
}

/** Show a picture with its caption, and no picture at all where the browser cannot show it. */
function picture(id, source, caption) {
  URL.revokeObjectURL($(id).src);
  $(id).hidden = true;
  $(id).src = source;
  $(`${id}-size`).textContent = caption;
  $(`${id}-figure`).hidden = false;
}

for (const id of ["original", "decoded"]) {
  $(id).addEventListener("load", () => ($(id).hidden = false));
}

function choose() {
  const file = $("file").files[0];
  if (!file) return;
  $("name").textContent = `${file.name}, ${size(file.size)}`;
  picture("original", URL.createObjectURL(file), `original, ${size(file.size)}`);
  $("decoded-figure").hidden = true;
  $("work").hidden = true;
}

function draw(trace) {
  const points = trace.filter((point) => point.psnr !== null);
  $("curve").toggleAttribute("hidden", points.length < 2);
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
  return say(`step ${last.step} of ${last.steps}${psnr}, ${last.seconds.toFixed(1)} s`);
}

async function show(job) {
  const { bytes, bpp, psnr, gaussians } = job.result;
  const times = (job.image.bytes / bytes).toFixed(0);
  const quality = psnr === null ? "without error" : `${psnr.toFixed(2)} dB`;
  picture("decoded", await blobUrl(job.decode_url), `decoded from ${size(bytes)}, ${times} times smaller`);
  $("download").href = await blobUrl(job.bitstream_url);
  $("download").download = `${job.id}.sg`;
  say(`${gaussians} Gaussians, ${bpp.toFixed(3)} bits per pixel, ${quality}`);
}

async function follow(id) {
  history.replaceState(null, "", `#${id}`); // a page that is loaded again finds its job
  $("cancel").hidden = false;
  $("encode").hidden = true;
  for (let tries = 0; ; ) {
    let job;
    try {
      job = await json(`/jobs/${id}`);
      tries = 0;
    } catch (error) {
      // The service may be restarting; the job waits for it.
      if (error.status === 404) throw new Error("the job was removed");
      if (!(error.status >= 500) || ++tries > RETRIES) throw error;
      say("the service does not answer; trying again");
      await sleep(RETRY_MS);
      continue;
    }
    report(job);
    if (job.state === "done") return show(job);
    await sleep(POLL_MS);
  }
}

async function submit() {
  const form = new FormData();
  form.append("image", $("file").files[0]);
  form.append("bpp", $("bpp").value);
  form.append("tune", $("tune").value);
  say("sending");
  return follow((await json("/encode", { method: "POST", body: form })).id);
}

async function work(task) {
  $("encode").disabled = true; // until there is a job to cancel
  $("work").hidden = $("progress").hidden = false;
  $("decoded-figure").hidden = true;
  $("progress").removeAttribute("value");
  draw([]);
  try {
    await task();
  } catch (error) {
    $("progress").hidden = true;
    say(error.message, true);
  } finally {
    $("encode").disabled = $("encode").hidden = false;
    $("cancel").hidden = true;
  }
}

$("form").addEventListener("submit", (event) => {
  event.preventDefault();
  work(submit);
});
$("cancel").addEventListener("click", () =>
  ask(`/jobs/${location.hash.slice(1)}`, { method: "DELETE" }).catch((error) => say(error.message, true)),
);
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

$("key").value = sessionStorage.getItem("key") ?? "";
$("key-field").hidden = !$("key").value;
$("key").addEventListener("input", () => sessionStorage.setItem("key", $("key").value));
if (/^#[0-9a-f]{32}$/.test(location.hash)) work(() => follow(location.hash.slice(1)));
