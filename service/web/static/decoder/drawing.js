// Gaussians to pixels: docs/format.md, "The pyramid" and "Views".

import { CELL, OCTAVES, SgError } from "./file.js";

const CUTOFF = 3;
const EDGE = Math.exp(-CUTOFF);
const KEPT = (1 - EDGE * (1 + CUTOFF + (CUTOFF * CUTOFF) / 2)) / (1 - EDGE * (1 + CUTOFF));
const NARROWEST = 1.4;
const TOP_LEVEL = 12;
export const MOST_PIXELS = 50e6;
export const MOST_SCALE = 64; // of a view; and one over it at least
const { fround, max, sqrt } = Math;

/** Halves to the even number. */
function rounded(x) {
  const below = Math.floor(x);
  const rest = x - below;
  return rest > 0.5 || (rest === 0.5 && below % 2) ? below + 1 : below;
}

/** A view: what part of the picture, how large it comes out. Throws SgError. */
function viewOf(file, scale = 1, region = null) {
  const [x, y, w, h] = region ?? [0, 0, file.width, file.height];
  const within = x >= 0 && y >= 0 && w >= 1 && h >= 1 && x + w <= file.width && y + h <= file.height;
  if (!(scale >= 1 / MOST_SCALE && scale <= MOST_SCALE) || !within) throw new SgError("this view is not in the picture");
  const [width, height] = [max(rounded(w * scale), 1), max(rounded(h * scale), 1)];
  if (width * height > MOST_PIXELS) throw new SgError("the picture is too large to be drawn here", true);
  return { x, y, width, height, sx: width / w, sy: height / h };
}

/** One Gaussian as the view shows it, into `out`: with the low-pass filter of smaller views. */
function place(values, at, { x, y, sx, sy, ox, oy, plain }, out) {
  const [l1, l2, l3] = [values[at + 2], values[at + 3], values[at + 4]];
  for (let i = 0; i < 8; i++) out[i] = values[at + i];
  if (plain) return;
  const [a, b, d] = [sx * l1, sy * l2, sy * l3];
  const [vx, vy] = [max(1 - sx * sx, 0) / (12 * KEPT), max(1 - sy * sy, 0) / (12 * KEPT)];
  const wide = sqrt(a * a + vx);
  const high = sqrt(d * d + vy + (b / wide) ** 2 * vx);
  const gain = (a * d) / (wide * high);
  out[0] = (values[at] - x) * sx + ox;
  out[1] = (values[at + 1] - y) * sy + oy;
  out[2] = wide;
  out[3] = a * (b / wide);
  out[4] = high;
  for (let i = 5; i < 8; i++) out[i] *= gain;
}

function levelOf(l1, l2, l3) {
  const xx = l1 * l1;
  const yy = l2 * l2 + l3 * l3;
  const minor = (2 * (xx * l3) * l3) / (xx + yy + sqrt((xx - yy) * (xx - yy) + 4 * (xx * l2) * l2));
  const ratio = minor / (NARROWEST * NARROWEST);
  let level = 0;
  while (level < TOP_LEVEL && 4 ** (level + 1) <= ratio) level++;
  return level;
}

/** In samples of its level, narrower and stronger. Places are counted from two samples before the picture. */
function toLevel(g, level) {
  if (level === 0) return;
  const samples = 2 ** level;
  const [p1, p2, p3] = [g[2] / samples, g[3] / samples, g[4] / samples];
  const v = (1 - 4 ** -level) / 4;
  const [xx, xy, yy] = [p1 * p1 - v, p1 * p2, p2 * p2 + p3 * p3 - v];
  const q1 = sqrt(xx);
  const q3 = sqrt(xx * yy - xy * xy) / q1;
  const gain = fround((p1 * p3) / (q1 * q3));
  g[0] = g[0] / samples + 2;
  g[1] = g[1] / samples + 2;
  g[2] = q1;
  g[3] = xy / q1;
  g[4] = q3;
  for (let i = 5; i < 8; i++) g[i] *= gain;
}

/** The samples of a level, three numbers each, from column `left` and row `top` on. */
class Plane {
  constructor(left, top, right, bottom) {
    [this.left, this.top, this.width, this.height] = [left, top, right - left, bottom - top];
    this.samples = new Float32Array(3 * this.width * this.height);
  }

  /** The part of the next level that is needed to enlarge it to this one. */
  above() {
    const { left, top, width, height } = this;
    const end = (first, count) => Math.floor((first + count - 1) / 2) + 2;
    return new Plane(Math.floor(left / 2) - 1, Math.floor(top / 2) - 1, end(left, width), end(top, height));
  }

  /** Add one Gaussian; `first` is where the centre of sample 0 lies. */
  add(g, first) {
    const [x, y, l1, l2, l3] = g;
    if (!(l1 > 0 && l3 > 0)) return;
    const { left, top, width, height, samples } = this;
    const slope = l2 / l3;
    const A = 1 + slope * slope;
    const reach = sqrt(2 * CUTOFF);
    const [high, centre] = [reach * sqrt(l2 * l2 + l3 * l3), x - first - left];
    const begin = max(Math.ceil(y - high - first) - top, 0);
    const end = Math.min(Math.floor(y + high - first) - top, height - 1);
    const bend = Math.exp(-A / (l1 * l1)); // the ratio of one ratio of neighbours to the next
    for (let j = begin; j <= end; j++) {
      const e = (j + top + first - y) / l3;
      const root = 2 * CUTOFF * A - e * e;
      if (root <= 0) continue;
      const middle = slope * e;
      const from = max(Math.ceil(centre + (l1 * (middle - sqrt(root))) / A), 0);
      const to = Math.min(Math.floor(centre + (l1 * (middle + sqrt(root))) / A), width - 1);
      if (from > to) continue;
      const z1 = (from - centre) / l1;
      const z2 = e - slope * z1;
      let weight = Math.exp(-(z1 * z1 + z2 * z2) / 2);
      let ratio = Math.exp(-(z1 - slope * z2 + A / (2 * l1)) / l1);
      for (let i = from, at = 3 * (j * width + from); i <= to; i++, at += 3) {
        const w = weight - EDGE;
        if (w > 0) {
          samples[at] += g[5] * w;
          samples[at + 1] += g[6] * w;
          samples[at + 2] += g[7] * w;
        }
        weight *= ratio;
        ratio *= bend;
      }
    }
  }

  /** Add what a plane of the next level comes to when it is enlarged by two. */
  addEnlarged(coarse) {
    const { left, top, width, height, samples } = this;
    const far = (n) => (n % 2 ? 1 : -1);
    const row = new Float32Array(3 * coarse.width);
    for (let j = 0; j < height; j++) {
      const near = Math.floor((j + top) / 2) - coarse.top;
      const [one, other] = [3 * near * coarse.width, 3 * (near + far(j + top)) * coarse.width];
      for (let i = 0; i < row.length; i++) row[i] = 0.75 * coarse.samples[one + i] + 0.25 * coarse.samples[other + i];
      for (let i = 0, at = 3 * j * width; i < width; i++, at += 3) {
        const place = 3 * (Math.floor((i + left) / 2) - coarse.left);
        const beside = place + 3 * far(i + left);
        for (let c = 0; c < 3; c++) samples[at + c] += 0.75 * row[place + c] + 0.25 * row[beside + c];
      }
    }
  }
}

const product = Math.imul;

function mix(h) {
  h ^= h >>> 16;
  h = product(h, 0x7feb352d);
  h ^= h >>> 15;
  h = product(h, 0x846ca68b);
  return h ^ (h >>> 16);
}

export const SIDE = 256; // samples after which noise repeats
export const NOISE_UNITS = [2 * 34.1 * 255, 2 * 29.7 * 255]; // by octave: half a level of 8 bits, of white, in its spread
const tables = [null, null];

/** Sums of neighbours in a plane that repeats, weighted along both axes. */
function filtered(plane, weights) {
  const middle = weights.length >> 1;
  const sums = (from, x, y) =>
    from.map((_, i) =>
      weights.reduce((sum, weight, k) => {
        const [column, row] = [i + x * (k - middle), (i >> 8) + y * (k - middle)];
        return sum + weight * from[SIDE * (row & (SIDE - 1)) + (column & (SIDE - 1))];
      }, 0),
    );
  return sums(sums(plane, 1, 0), 0, 1);
}

/** Noise of an octave, row by row: white noise less its mean around each sample; the finest octave is smoothed. */
export function noiseOf(octave) {
  if (tables[octave]) return tables[octave];
  const white = Int32Array.from({ length: SIDE * SIDE }, (_, i) => {
    const row = i >> 8;
    return ((mix((i & (SIDE - 1)) + mix(mix(1) + (row >> 2))) >>> (8 * (row & 3))) & 255) - 128;
  });
  const mean = filtered(white, octave ? [1, 2, 1] : [1, 4, 6, 4, 1]);
  const detail = white.map((value, i) => (octave ? 16 : 256) * value - mean[i]);
  const noise = octave ? detail.map((value) => (value + 16) >> 5) : filtered(detail, [1, 6, 1]).map((v) => (v + 8192) >> 14);
  return (tables[octave] = Int8Array.from(noise));
}

/** The two neighbouring cells of a position, and the fraction between them. */
function between(place, cells) {
  const at = Math.min(max(place / CELL - 0.5, 0), cells - 1);
  const low = Math.floor(at);
  return [low, Math.min(low + 1, cells - 1), at - low];
}

/** Noise as strong as an octave's codes say, on a level of a view. */
function addTexture(plane, texture, octave, level, { x, y, sx, sy, ox, oy }, gain) {
  const { columns, rows } = texture;
  const strengths = Float64Array.from(texture.octaves[octave], (code) =>
    code === 0 ? 0 : (gain * 2 ** ((code - 1) / 2)) / NOISE_UNITS[octave],
  );
  const side = 2 ** level;
  const table = noiseOf(octave);
  const across = Array.from({ length: plane.width }, (_, i) =>
    between(((plane.left + i + 0.5) * side - ox + x * sx) / sx, columns),
  );
  for (let j = 0, at = 0; j < plane.height; j++) {
    const down = ((plane.top + j + 0.5) * side - oy + y * sy) / sy;
    const [above, below, share] = between(down, rows);
    const row = SIDE * ((plane.top + j) & (SIDE - 1));
    for (let i = 0; i < plane.width; i++, at += 3) {
      const [left, right, part] = across[i];
      const along = (r) => strengths[r * columns + left] * (1 - part) + strengths[r * columns + right] * part;
      const strength = along(above) * (1 - share) + along(below) * share;
      if (strength === 0) continue;
      const value = table[row + ((plane.left + i) & (SIDE - 1))] * strength;
      for (let c = 0; c < 3; c++) plane.samples[at + c] += value;
    }
  }
}

/** On which level of a view each octave is drawn, and how strongly; none where it is finer than the view. */
export function octavesOf({ sx, sy }) {
  const n = Math.floor(Math.log2(2 * sx * sy) / 2);
  const found = [];
  for (let octave = 0; octave < OCTAVES; octave++) {
    const level = octave + n;
    if (level >= 0 && level <= TOP_LEVEL) found.push({ octave, level, gain: n < 0 && level === 0 ? 0.75 : 1 });
  }
  return found;
}

/** The first `count` Gaussians of a file as a picture: { width, height, data }, RGBA of 8 bits. Throws SgError. */
export function draw(file, { scale = 1, region = null, count = file.count, texture = true } = {}) {
  const view = viewOf(file, scale, region);
  const { width, height, x, y, sx, sy } = view;
  const ox = Math.floor(x * sx) % 65536;
  const oy = Math.floor(y * sy) % 65536;
  const placing = { ...view, ox, oy, plain: sx === 1 && sy === 1 && x === 0 && y === 0 };
  const byLevel = Array.from({ length: TOP_LEVEL + 1 }, () => []);
  const g = new Float32Array(8);
  for (let i = 0; i < count; i++) {
    place(file.values, 8 * i, placing, g);
    byLevel[levelOf(g[2], g[3], g[4])].push(i);
  }
  const octaves = texture && file.texture ? octavesOf(view) : [];
  let top = TOP_LEVEL;
  while (top > 0 && byLevel[top].length === 0 && !octaves.some(({ level }) => level === top)) top--;
  const planes = [new Plane(ox, oy, ox + width, oy + height)];
  while (planes.length <= top) planes.push(planes.at(-1).above());
  for (let level = top; level >= 0; level--) {
    if (level < top) planes[level].addEnlarged(planes.pop());
    for (const i of byLevel[level]) {
      place(file.values, 8 * i, placing, g);
      toLevel(g, level);
      planes[level].add(g, level === 0 ? 0.5 : 2.5);
    }
    for (const { octave, level: its, gain } of octaves) {
      if (its === level) addTexture(planes[level], file.texture, octave, level, placing, gain);
    }
  }
  const data = toBytes(planes[0].samples, file.background);
  if (file.alpha) {
    const grey = draw(file.alpha, { scale, region }).data;
    for (let at = 0; at < data.length; at += 4) data[at + 3] = grey[at];
  }
  return { width, height, data };
}

/** What a picture that can be seen through is on white, in place. */
export function layOverWhite({ data }) {
  for (let at = 0; at < data.length; at += 4) {
    const share = data[at + 3] / 255;
    for (let c = 0; c < 3; c++) data[at + c] = data[at + c] * share + 255 * (1 - share);
    data[at + 3] = 255;
  }
}

function toBytes(samples, background) {
  const data = new Uint8ClampedArray((samples.length / 3) * 4);
  const [red, green, blue] = background.map((level) => level + 0.5);
  for (let from = 0, to = 0; from < samples.length; from += 3, to += 4) {
    data[to] = Math.floor(255 * samples[from] + red);
    data[to + 1] = Math.floor(255 * samples[from + 1] + green);
    data[to + 2] = Math.floor(255 * samples[from + 2] + blue);
    data[to + 3] = 255;
  }
  return data;
}
