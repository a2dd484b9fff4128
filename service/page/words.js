// Numbers in words.

export function size(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  if (bytes < 1e6) return `${(bytes / 1e3).toFixed(bytes < 1e4 ? 1 : 0)} kB`;
  return `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;
}

export const count = (n) => n.toLocaleString("en");

export function smaller(from, to) {
  const times = from / to;
  if (times < 1.05) return "not smaller";
  return `${times < 10 ? times.toFixed(1) : Math.round(times)} times smaller`;
}

export const decibels = (psnr) => (psnr === Infinity ? "no error" : `${psnr.toFixed(1)} dB`);

export function seconds(s) {
  const whole = Math.max(1, Math.round(s));
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

/** Estimate the number of Gaussians in a file: each takes 2.4 to 4 bytes. */
export function expected(bytes) {
  const gaussians = Math.max(1, Number(Math.max(bytes / 3.3 - 5, 1).toPrecision(2)));
  return `about ${count(gaussians)} Gaussians${gaussians < 50 ? ", too few for more than a rough idea of it" : ""}`;
}

/** Describe an SSIM. The bounds come from files of 0.05 to 2 bits per pixel. */
export function closeness(ssim) {
  if (ssim < 0.72) return "a rough idea of the original";
  return ssim < 0.97 ? "fine detail is lost" : "hardly different from the original";
}

/** The least SSIMULACRA 2 of each word, as its author names them. */
const QUALITIES = [[90, "no visible loss"], [70, "high"], [50, "medium"], [30, "low"]];

/** What a SSIMULACRA 2 means in a word or three. */
export const qualityWord = (score) => QUALITIES.find(([least]) => score >= least)?.[1] ?? "very low";

export const withoutSuffix = (name) => name.replace(/\.[^.]*$/, "") || "picture";
