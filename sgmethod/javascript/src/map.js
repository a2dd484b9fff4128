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

/** Index of a class in tables. */
export const groupOf = (k) => min(k + 4, 13);

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

/** Sums in single precision of blocks side by side, and of 3 by 3 blocks around the one at i. */
const along = (plane, i) => fround(fround(plane[i - 1] + plane[i]) + plane[i + 1]);
const sumAround = (plane, i, stride) =>
  fround(fround(along(plane, i - stride) + along(plane, i)) + along(plane, i + stride));

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
  let known = 0; // energy before it
  let before; // planes, as they were before it
  let ofClass; // the same in its blocks
  let F;
  let [group, M, n, counts, i] = []; // i: of the block, in counts
  const at = {}; // block, level, part; columns; halvings from a block to a cell

  /** A plane with these values. */
  const newPlane = (bits, value) => {
    const plane = new Float32Array(indexOf(bits, rowsOf(bits) + 3, 0));
    for (let r = rowsOf(bits); r--; ) for (let c = columnsOf(bits); c--; ) plane[indexOf(bits, r, c)] = value(r, c);
    return plane;
  };
  const pooled = (plane, bits) => {
    const down = strideOf(bits);
    return newPlane(bits + 1, (r, c) => {
      const i = indexOf(bits, 2 * r - 2, 2 * c - 2);
      return r && c && fround(plane[i] + plane[i + down]) + fround(plane[i + 1] + plane[i + down + 1]);
    });
  };
  const divided = (plane, bits) =>
    newPlane(bits - 1, (r, c) => plane[indexOf(bits, (r >> 1) + 1, (c >> 1) + 1)] / 4);

  /** Prepare for a number of Gaussians of class k. */
  const begin = (k, number) => {
    const g = max(0, (k + 1) >> 1);
    let bits = max(g, 3);
    while (bits < 12 && columnsOf(bits) * rowsOf(bits) > 8 * gaussians + 1024) bits++;
    WHOLE: {
      planes ??= [0, 0, 0].map(() => newPlane(bits, () => 0));
      for (let finer = m ?? bits; finer > bits; finer--) planes = planes.map((plane) => divided(plane, finer));
      before = ofClass = planes.map((plane) => plane.slice());
      known = energy;
      group = groupOf(k);
    }
    m = bits;
    for (M = m, n = number; M < 12 && insideOf(M) > 8 * n + 64; M++) {
      WHOLE: ofClass = ofClass.map((plane) => pooled(plane, M));
    }
    at.halvings = M - g;
    at.columns = columnsOf(M);
    WHOLE: {
      F = pooled(pooled(ofClass[0], M), M + 1);
      counts = new Uint8ClampedArray((at.columns + 4) * (rowsOf(M) + 4));
    }
    at.block = at.part = 0;
    enter();
  };

  /** How many Gaussians a block has by those in some near it, as a logarithm. */
  const own = (near, blocks) => lg(floor((256 * near * insideOf(M)) / (blocks * n)) + 77) - 128;

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
      const [E, X, Y] = ofClass;
      const block = indexOf(M, r, c);
      const mean = meanOf(M);
      const S = sumAround(E, block, strideOf(M));
      const SF = sumAround(F, indexOf(M + 2, (r + 6) >> 2, (c + 6) >> 2), strideOf(M + 2));
      const turned = fround(abs(sumAround(X, block, strideOf(M))) + abs(sumAround(Y, block, strideOf(M))));
      const [f0, f1] = [limited(L(E[block]) - mean), limited(L(S, 9) - mean)];
      const [f2, f3] = [limited(L(SF, 144) - mean), limited(L(turned) - L(S))];
      parts += NET[group] + predicted(14, 90, group, f0, f1, f2, f3);
      let q = 0;
      for (let d = 1; d < 5; d++) {
        q += counts[i - d];
        for (let at = i - d * stride - 4, end = at + 9; at < end; at++) q += counts[at];
      }
      const up = i - stride;
      const p = 2 * (counts[i - 1] + counts[up]) + counts[up - 1] + counts[up + 1];
      parts += predicted(90, 147, group, own(min(p, 63), 6), own(min(q, 255), 40), density, 0);
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
      const block = indexOf(m, y, x);
      const [E, X, Y] = before;
      const S = sumAround(E, block, strideOf(m));
      const energy = L(fround(S * fround(1 / 9))) - meanOf(m);
      spot.lumaRow = MAPPED_LUMA + min(max(floor(energy / 24 + 4), 0), 7);
      const direction = directionOf(S * S, sumAround(X, block, strideOf(m)), sumAround(Y, block, strideOf(m)));
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
