// What is drawn over the picture: the Gaussians' ellipses, and where the bits went.

const MAX_ELLIPSES = 5000;
const CELL = 6; // pixels of the picture for one of the heat map

/** Ellipses at one standard deviation: orange ones add light, blue ones take it away. */
export function drawEllipses(context, file, count, { zoom, x, y, left, right, height }) {
  const adding = new Path2D();
  const taking = new Path2D();
  const { values } = file;
  let drawn = 0;
  for (let i = 0; i < count && drawn < MAX_ELLIPSES; i++) {
    const at = 8 * i;
    const [l1, l2, l3] = [values[at + 2] * zoom, values[at + 3] * zoom, values[at + 4] * zoom];
    const [cx, cy] = [(values[at] - x) * zoom, (values[at + 1] - y) * zoom];
    const reach = l1 + Math.abs(l2) + l3;
    if (cx + reach < left || cx - reach > right || cy + reach < 0 || cy - reach > height) continue;
    const [xx, xy, yy] = [l1 * l1, l1 * l2, l2 * l2 + l3 * l3];
    const root = Math.hypot((xx - yy) / 2, xy);
    const long = Math.sqrt((xx + yy) / 2 + root);
    const short = Math.sqrt(Math.max((xx + yy) / 2 - root, 0));
    if (long < 1) continue;
    const angle = Math.atan2(2 * xy, xx - yy) / 2;
    const path = values[at + 5] + values[at + 6] + values[at + 7] >= 0 ? adding : taking;
    path.moveTo(cx + long * Math.cos(angle), cy + long * Math.sin(angle));
    path.ellipse(cx, cy, long, short, angle, 0, 2 * Math.PI);
    drawn++;
  }
  context.lineWidth = 1;
  for (const [path, colour] of [[adding, "#ff9d4d"], [taking, "#6cb6ff"]]) {
    context.strokeStyle = colour;
    context.stroke(path);
  }
}

/** The bits of a file, spread over its Gaussians' ellipses: { columns, rows, cells, max }, in bits per pixel. */
export function heatOf(file) {
  const [columns, rows] = [Math.ceil(file.width / CELL), Math.ceil(file.height / CELL)];
  const cells = new Float32Array(columns * rows);
  for (let i = 0; i < file.count; i++) {
    const [x, y, l1, l2, l3] = file.values.subarray(8 * i, 8 * i + 5);
    // In cells, and at least as wide as one, so that none falls between them.
    const wide = Math.sqrt((l1 / CELL) ** 2 + 0.25);
    const slant = ((l1 / CELL) * (l2 / CELL)) / wide;
    const high = Math.sqrt(Math.max((l2 / CELL) ** 2 + (l3 / CELL) ** 2 - slant * slant, 0) + 0.25);
    const [cx, cy] = [x / CELL - 0.5, y / CELL - 0.5];
    const density = file.bits[i] / (2 * Math.PI * wide * high * CELL * CELL);
    const [reachX, reachY] = [2.5 * wide, 2.5 * Math.hypot(slant, high)];
    for (let r = Math.max(Math.ceil(cy - reachY), 0); r <= Math.min(cy + reachY, rows - 1); r++) {
      for (let c = Math.max(Math.ceil(cx - reachX), 0); c <= Math.min(cx + reachX, columns - 1); c++) {
        const z1 = (c - cx) / wide;
        const z2 = (r - cy - slant * z1) / high;
        cells[r * columns + c] += density * Math.exp(-(z1 * z1 + z2 * z2) / 2);
      }
    }
  }
  const sorted = cells.slice().sort();
  return { columns, rows, cells, max: sorted[Math.floor(0.995 * (sorted.length - 1))] || 1e-6 };
}

/** The heat map as a small picture: from dark violet, through orange, to pale yellow. */
export function heatPicture({ columns, rows, cells, max }) {
  const image = new ImageData(columns, rows);
  for (let i = 0; i < cells.length; i++) {
    const t = Math.min(cells[i] / max, 1) ** 0.7;
    image.data.set([255 * Math.min(1, 0.12 + 1.5 * t), 235 * t ** 1.5, 90 * (1 - t) + 120 * t ** 4, 225], 4 * i);
  }
  const canvas = new OffscreenCanvas(columns, rows);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}
