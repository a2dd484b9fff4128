// Numbers as people say them.

export function size(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  if (bytes < 1e6) return `${(bytes / 1e3).toFixed(bytes < 1e4 ? 1 : 0)} kB`;
  return `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;
}

export const count = (n) => n.toLocaleString("en");

export function smaller(from, to) {
  const times = from / to;
  if (times < 1.05) return "not smaller than your file";
  return `${times < 10 ? times.toFixed(1) : Math.round(times)} times smaller`;
}

export const decibels = (psnr) => (psnr === null || psnr === Infinity ? "no error" : `${psnr.toFixed(1)} dB`);

export function seconds(s) {
  if (s < 60) return `${Math.max(1, Math.round(s))} s`;
  return `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`;
}

/** What to expect of so many bits per pixel. */
export function expected(bpp) {
  if (bpp < 0.08) return "a rough idea of the picture";
  if (bpp < 0.16) return "good enough for a preview";
  if (bpp < 0.35) return "good at a glance";
  if (bpp < 0.7) return "good when looked at closely";
  if (bpp < 1.3) return "hardly different";
  return "as close as it gets";
}

export const withoutSuffix = (name) => name.replace(/\.[^.]*$/, "") || "picture";
