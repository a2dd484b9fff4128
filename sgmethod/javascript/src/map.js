// The walk through a class's blocks, and what the Gaussians decoded so far tell of them: docs/format.md, "The map". Short
// files have no map, and modules that read only these leave out what is labelled WHOLE.

import { abs, floor, fround, max, min, refuseUnless } from "./header.js";
import { LUMA, MAPPED_LUMA, MAPPED_R, MAPPED_SIGNS, MAPPED_V, NET, R_BY_DIRECTION, SHAPE_SIGNS, V } from "./models.js";

const TINY = 2 ** -12;
const view = new DataView(new ArrayBuffer(8));

/** The logarithm to base two in sixteenths, linear between powers of two: exponent and four bits of the fraction. */
export function lg(x) {
  view.setFloat64(0, x);
  return view.getUint16(0) - 16368;
}

/** lg() of a number in single precision, after something tiny is added. */
const L = (x, times = 1) => lg(fround(x + times * TINY));

/** Index of a class in tables; of a class that no file may have, too, since previews are read without that check, and a
 * symbol by a model that is not there would be searched for ever. */
export const groupOf = (k) => min(max(k + 4, 0), 13);

const limited = (x) => min(max(x, -255), 255);

/** What units of the networks say, each of 19 numbers: four weights, that of its output, and biases by group. */
function predicted(at, end, group, a, b, c, d) {
  let sum = 0;
  for (; at < end; at += 19) {
    const unit = 64 * NET[at + 5 + group] + NET[at] * a + NET[at + 1] * b + NET[at + 2] * c + NET[at + 3] * d;
    sum += NET[at + 4] * (max(unit, 0) >> 6);
  }
  return sum >> 6;
}

/** Every other bit of a number below 2^20. */
function even(n) {
  let found = 0;
  for (let bit = 1; n; n >>= 2, bit *= 2) found += n & 1 && bit;
  return found;
}

/** The sums in single precision of the 3 by 3 blocks around each. */
function sumsOf(plane, stride) {
  const across = new Float32Array(plane.length);
  for (let i = 1; i < plane.length - 1; i++) across[i] = fround(plane[i - 1] + plane[i]) + plane[i + 1];
  const sums = new Float32Array(plane.length);
  for (let i = stride; i < plane.length - stride; i++) {
    sums[i] = fround(across[i - stride] + across[i]) + across[i + stride];
  }
  return sums;
}

/** The functions that walk through a class and make a map of it, and where they are.
 *
 * Planes of the map have zeros around their blocks: a row above and three below, and three columns behind each row. */
export function newMap({ width, height, isShort }) {
  const columnsOf = (bits) => ((width - 1) >> bits) + 5;
  const rowsOf = (bits) => ((height - 1) >> bits) + 5;
  const insideOf = (bits) => (columnsOf(bits) - 4) * (rowsOf(bits) - 4);
  const strideOf = (bits) => columnsOf(bits) + 3;
  const indexOf = (bits, r, c) => (r + 1) * strideOf(bits) + c + 1;
  const meanOf = (bits) => L(fround(known / insideOf(bits)));

  let planes; // E, X, Y
  let m; // bits of a block's side
  let gaussians = 0;
  let energy = 0; // of all of them
  // Of the class:
  let known; // energy before it
  let sums; // around the blocks of planes, as they were before it, and their mean
  let mean;
  let predictions; // for its own blocks, by what was before it
  let counts; // of its Gaussians in each block, with four blocks of zeros around
  let above; // of its Gaussians in the 9 by 4 blocks above each of a row
  let [group, M, n, i] = []; // i: of the block, in counts
  const at = {}; // block, level, part; columns; halvings from a block to a cell

  const newPlane = (bits) => new Float32Array(indexOf(bits, rowsOf(bits) + 3, 0));
  const pooled = (plane, bits) => {
    const coarse = newPlane(bits + 1);
    const down = strideOf(bits);
    for (let r = 1; r < rowsOf(bits + 1); r++) {
      for (let c = columnsOf(bits + 1), to = indexOf(bits + 1, r, c); --c; ) {
        const i = indexOf(bits, 2 * r - 2, 2 * c - 2);
        coarse[--to] = fround(plane[i] + plane[i + down]) + fround(plane[i + 1] + plane[i + down + 1]);
      }
    }
    return coarse;
  };
  const divided = (plane, bits) => {
    const finer = newPlane(bits - 1);
    for (let r = rowsOf(bits - 1); r--; ) {
      const row = indexOf(bits, (r >> 1) + 1, 1);
      for (let c = columnsOf(bits - 1), to = indexOf(bits - 1, r, c); c--; ) finer[--to] = plane[row + (c >> 1)] / 4;
    }
    return finer;
  };

  /** Prepare for a number of Gaussians of class k. */
  const begin = (k, number) => {
    const g = max(0, (k + 1) >> 1);
    let bits = max(g, 3);
    while (bits < 12 && columnsOf(bits) * rowsOf(bits) > 8 * gaussians + 1024) bits++;
    for (M = bits, n = number; M < 12 && insideOf(M) > 8 * n + 64; M++);
    at.halvings = M - g;
    at.columns = columnsOf(M);
    WHOLE: {
      planes ??= [0, 0, 0].map(() => newPlane(bits));
      for (let finer = m ?? bits; finer > bits; finer--) planes = planes.map((plane) => divided(plane, finer));
      known = energy;
      group = groupOf(k);
      counts = new Uint8ClampedArray((at.columns + 4) * (rowsOf(M) + 4));
      above = new Int32Array(at.columns);
      m = bits;
      if (known) predict();
    }
    at.block = at.part = 0;
    enter();
  };

  /** What the map says of each of the class's blocks. */
  const predict = () => {
    sums = planes.map((plane) => sumsOf(plane, strideOf(m)));
    mean = meanOf(m);
    let pools = planes;
    for (let bits = m; bits < M; bits++) pools = pools.map((plane) => pooled(plane, bits));
    const [E] = pools;
    const [S, SX, SY] = M > m ? pools.map((plane) => sumsOf(plane, strideOf(M))) : sums;
    const SF = sumsOf(pooled(pooled(E, M), M + 1), strideOf(M + 2));
    const meanOfClass = meanOf(M);
    predictions = new Int32Array(at.columns * rowsOf(M));
    for (let r = 0, to = 0; r < rowsOf(M); r++) {
      for (let c = 0, i = indexOf(M, r, 0); c < at.columns; c++, i++) {
        const l = L(S[i]);
        const f0 = limited(L(E[i]) - meanOfClass);
        const f1 = limited(L(S[i], 9) - meanOfClass);
        const f2 = limited(L(SF[indexOf(M + 2, (r + 6) >> 2, (c + 6) >> 2)], 144) - meanOfClass);
        const f3 = limited(L(fround(abs(SX[i]) + abs(SY[i]))) - l);
        predictions[to++] = NET[group] + predicted(14, 90, group, f0, f1, f2, f3);
      }
    }
  };

  /** How many Gaussians a block has by those in some near it, as a logarithm. */
  const own = (near, blocks) => lg(floor((256 * near * insideOf(M)) / (blocks * n)) + 77) - 128;

  /** Count the Gaussians in the 9 by 4 blocks above each of a row. */
  const countAbove = () => {
    const stride = at.columns + 4;
    let sum = 0;
    for (let c = -8; c < at.columns; c++) {
      for (let at = i + c, d = 0; d < 4; d++) {
        at -= stride;
        sum += counts[at + 4];
        if (c > 0) sum -= counts[at - 5];
      }
      if (c >= 0) above[c] = sum;
    }
  };

  /** Find the level of the current block. */
  const enter = () => {
    const r = floor(at.block / at.columns);
    const c = at.block % at.columns;
    refuseUnless(r < rowsOf(M), "a place is out of range");
    const density = lg(floor((256 * n) / insideOf(M)) + 1) - 128;
    let parts = density + (r > 1 && c > 1 && r < rowsOf(M) - 2 && c < at.columns - 2 ? 104 : 56);
    WHOLE: {
      const stride = at.columns + 4;
      i = (r + 4) * stride + c + 4;
      if (!known) break WHOLE;
      if (!c) countAbove();
      const up = i - stride;
      const p = 2 * (counts[i - 1] + counts[up]) + counts[up - 1] + counts[up + 1];
      const q = above[c] + counts[i - 1] + counts[i - 2] + counts[i - 3] + counts[i - 4];
      const seen = predicted(90, 147, group, own(min(p, 63), 6), own(min(q, 255), 40), density, 0);
      parts += predictions[at.block] + seen;
    }
    at.level = min(max(parts >> 4, 0), 20);
  };

  /** Move on by some parts. */
  const advance = (parts) => {
    for (at.part += parts; at.part >= 1 << at.level; enter()) {
      at.part -= 1 << at.level;
      at.block++;
    }
  };

  /** Count a Gaussian in the current block, and set what its part tells: the block's first cell, the part of the block,
   * by how many bits it divides a cell along x and y, and the rows of models that are chosen by what surrounds it. */
  const look = (spot) => {
    const { level, part, halvings, columns } = at;
    const odd = level & 1;
    const row = floor(at.block / columns) - 2;
    const column = (at.block % columns) - 2;
    spot.left = column * 2 ** halvings;
    spot.top = row * 2 ** halvings;
    spot.across = even(part >> odd);
    spot.down = even(part >> (1 - odd));
    spot.xBits = (level >> 1) - halvings;
    spot.yBits = ((level + 1) >> 1) - halvings;
    spot.lumaRow = LUMA;
    spot.vRow = V;
    spot.rRow = R_BY_DIRECTION;
    spot.signsRow = SHAPE_SIGNS;
    WHOLE: {
      counts[i]++;
      if (!known) break WHOLE;
      const place = (first, part, bits, blocks) =>
        min(max(first * 2 ** (M - m) + ((part << (M - m)) >> bits) + 2, 0), blocks - 1);
      const x = place(column, spot.across, level >> 1, columnsOf(m));
      const y = place(row, spot.down, (level + 1) >> 1, rowsOf(m));
      const [S, SX, SY] = sums.map((plane) => plane[indexOf(m, y, x)]);
      spot.lumaRow = MAPPED_LUMA + min(max(floor((L(fround(S * fround(1 / 9))) - mean) / 24 + 4), 0), 7);
      const direction = directionOf(S * S, SX, SY);
      spot.signsRow = MAPPED_SIGNS + 4 * (direction - 1);
      if (direction < 2) break WHOLE;
      const fold = foldOf(direction);
      spot.vRow = MAPPED_V + 8 * (fold - 1);
      spot.rRow = MAPPED_R + 32 * (fold - 1);
    }
  };

  let add;
  /** Add a Gaussian, whose numbers are at `of` in an array, to the map. strength: of its colour, for its size. */
  WHOLE: add = (strength, values, of) => {
    if (isShort) return;
    const x = values[of];
    const y = values[of + 1];
    const l1 = values[of + 2];
    const l2 = values[of + 3];
    const l3 = values[of + 4];
    const by = strength / (l1 * l3);
    const yy = l2 * l2 + l3 * l3;
    const E = fround(by * (l1 * l1 + yy));
    const X = fround(by * (yy - l1 * l1));
    const Y = fround(by * (-2 * (l1 * l2)));
    gaussians++;
    energy += 4 * E;
    const place = (u, blocks) => floor(min(max(fround(fround(u) / 2 ** m + 2), 0), blocks - 1));
    const put = (dx, dy) => {
      const r = place(y + fround(1.25 * dy), rowsOf(m));
      const block = indexOf(m, r, place(x + fround(1.25 * dx), columnsOf(m)));
      planes[0][block] += E;
      planes[1][block] += X;
      planes[2][block] += Y;
    };
    put(l1, l2);
    put(-l1, -l2);
    put(0, l3);
    put(0, -l3);
  };

  return [begin, advance, look, add, at];
}

/** Which way the gradient points, and how surely, in 26 kinds. */
function directionOf(square, x, y) {
  const sum = x * x + y * y;
  if (!square || 25 * sum < square) return 1;
  const diagonal = x > 0 ? (y > 0 ? 1 : 7) : y > 0 ? 3 : 5;
  const [across, down] = [abs(x), abs(y)];
  const octant = 5 * down < 2 * across ? (diagonal + 1) & 4 : 5 * across < 2 * down ? (diagonal & 4) + 2 : diagonal;
  return 2 + 8 * ((5 * sum >= square) + (2 * sum >= square)) + octant;
}

/** The same of directions that mirror each other, from 2 on. */
const foldOf = (direction) => 1 + 3 * ((direction - 2) >> 3) + (direction & 1 || (direction - 2) & 3);
