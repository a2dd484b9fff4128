// The progress of a job: place in the queue, seconds left, and the chart of the fit.

import { $ } from "./parts.js";
import { count, decibels, seconds } from "./words.js";

const [WIDTH, HEIGHT] = [560, 240];
const [LEFT, RIGHT, TOP, BOTTOM] = [62, 14, 14, 60];

/** A new SVG element. */
function shape(tag, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
}

/** A round step that divides a range into about so many parts. */
function stepOf(range, parts) {
  const rough = range / parts || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough);
}

function ticks(low, high, step) {
  const found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + 1e-9; at += step) found.push(Number(at.toFixed(6)));
  return found;
}

/** Draw the trace as a chart. end: the PSNR of the finished file, drawn as a dot. */
export function drawTrace(trace, end = null) {
  const chart = $("chart");
  // The last points are measured after rounding, as is the file, which has its own dot.
  const points = trace.filter((point) => point.psnr !== null && point.phase !== "done");
  $("chart-card").hidden = points.length < 2;
  if (points.length < 2) return;
  const all = [...points.map((point) => point.psnr), ...(end === null ? [] : [end])];
  const last = Math.max(trace.at(-1).seconds, 0.1);
  const [min, max] = [Math.min(...all), Math.max(...all)];
  const step = stepOf(max - min, 4);
  const low = step * Math.floor(min / step);
  const high = Math.max(step * Math.ceil(max / step), low + step); // the curve stays between the outer ticks
  const x = (s) => LEFT + ((WIDTH - LEFT - RIGHT) * s) / last;
  const y = (psnr) => TOP + ((HEIGHT - TOP - BOTTOM) * (high - psnr)) / (high - low);
  const parts = [];
  for (const psnr of ticks(low, high, step)) {
    parts.push(shape("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(psnr), y2: y(psnr), class: "grid" }));
    parts.push(shape("text", { x: LEFT - 8, y: y(psnr) + 6, "text-anchor": "end" }, psnr));
  }
  for (const at of ticks(0, last, stepOf(last, 5))) {
    parts.push(shape("text", { x: x(at), y: HEIGHT - BOTTOM + 24, "text-anchor": "middle" }, at));
  }
  parts.push(shape("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, "seconds"));
  const middle = (TOP + HEIGHT - BOTTOM) / 2;
  const side = { x: 16, y: middle, "text-anchor": "middle", transform: `rotate(-90 16 ${middle})` };
  parts.push(shape("text", side, "PSNR, dB"));
  const places = points.map((point) => `${x(point.seconds).toFixed(1)},${y(point.psnr).toFixed(1)}`);
  parts.push(shape("polyline", { points: places.join(" ") }));
  if (end !== null) parts.push(shape("circle", { cx: x(last), cy: y(end), r: 4 }));
  const dot = end === null ? "" : ` The dot is the file: ${decibels(end)}.`;
  $("chart-words").textContent = `Higher is closer to the original; dropping Gaussians that help least costs a little.${dot}`;
  chart.setAttribute("aria-label", `Quality against time: ${decibels(points.at(-1).psnr)} after ${seconds(last)}`);
  chart.replaceChildren(...parts);
}

/** Describe what a job is doing, and its progress from 0 to 1; null if unknown. */
export function stateOf(job) {
  if (job.state === "queued") {
    const ahead = job.position - 1;
    return { words: `Waiting: ${ahead === 0 ? "next in the queue" : `in the queue, ${ahead} before it`}`, done: null };
  }
  const last = job.trace.at(-1);
  if (!last) return { words: "Starting the encoder", done: null };
  if (job.progress === 1 && last.step === last.steps) return { words: "Writing and measuring the file", done: null };
  const rest = job.seconds_left >= 0.5 ? `, about ${seconds(job.seconds_left)} left` : "";
  return { words: `Fitting ${count(last.gaussians ?? 0)} Gaussians${rest}`, done: job.progress };
}
