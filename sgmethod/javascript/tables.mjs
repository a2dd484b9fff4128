// Packs the tables that benchmarks.coder trains, from the C++ sources into src/tables.js: node tables.mjs.
// src/models.js unpacks them.

import { readFileSync, writeFileSync } from "node:fs";
import { FLAT, modelsOf } from "./src/coder.js";
import { newWriter, write } from "./src/encoder/coder.js";

/** The numbers of an array in sgmethod/native/rd/. */
function numbersOf(file, name) {
  const text = readFileSync(new URL(`../native/rd/${file}.h`, import.meta.url), "utf8");
  return text.match(new RegExp(` ${name}\\[.* = ({[^;]*);`))[1].match(/-?\d+/g).map(Number);
}
const KINDS = ["Count", "Distance", "LumaByEnergy", "LumaByClass", "A", "AByClass", "B", "BByLuma", "ColorSigns"];
KINDS.push("V", "VByClass", "R", "RByDirection", "ShapeSigns");
const starts = numbersOf("start_tables", "kStarts");
const rows = KINDS.map((kind) => numbersOf("start_tables", `kStart${kind}`));

/** A network as src/map.js takes it. */
function unitsOf(name, inputs) {
  const [bias, weights, out] = ["Bias", "Weights", "Out"].map((kind) => numbersOf("structure_net", `k${name}${kind}`));
  return out.flatMap((weight, h) => {
    const own = [0, 1, 2, 3].map((i) => (i < inputs ? weights[inputs * h + i] : 0));
    return [...own, weight, ...bias.filter((_, i) => i % out.length === h)];
  });
}
const net = [...numbersOf("structure_net", "kMapBase"), ...unitsOf("Map", 4), ...unitsOf("Own", 3)];

const writer = newWriter(modelsOf(FLAT));
const writeSigned = (value, row) => write(writer, value < 0 ? -2 * value - 1 : 2 * value, row);
write(writer, starts.length / 15, 0);
starts.forEach((start, i) => {
  const before = i % 15 ? starts[i - 1] : 0;
  write(writer, start - before, 31 - Math.clz32(256 - before));
});
const [first, end] = [KINDS.indexOf("RByDirection"), KINDS.indexOf("ShapeSigns")].map((n) => rows.slice(0, n).flat().length);
rows.flat().forEach((row, i, all) => writeSigned(row - (all[i - (i >= first && i < end ? 4 : 1)] ?? 0), 9));
net.forEach((value, i) => writeSigned(value - (net[i - 1] ?? 0), 10));
const packed = Buffer.from(writer.bytes()).toString("base64").replaceAll("=", "");
writeFileSync(
  new URL("src/tables.js", import.meta.url),
  `// Made by tables.mjs.\n\nexport const PACKED =\n  "${packed}";\n`,
);
console.log(packed.length);
