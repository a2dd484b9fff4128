// The Gaussians' ellipses, over the picture.

const MAX_ELLIPSES = 5000;

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
