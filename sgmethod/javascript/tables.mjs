// Packs the tables that tests.bitstream.train trains, from the C++ sources into src/tables.js: node tables.mjs.
// src/models.js unpacks them.

import { writeFileSync, readFileSync } from "node:fs";
import { FLAT, modelsOf } from "./src/coder.js";
import { newWriter, write } from "./src/encoder/coder.js";

/** The numbers of an array in sgmethod/native/rd/. */
function numbersOf(file, name) {
  const text = readFileSync(new URL(`../native/rd/${file}.h`, import.meta.url), "utf8");
  return text.match(new RegExp(` ${name}\\[.* = ({[^;]*);`))[1].match(/-?\d+/g).map(Number);
}

/** A network as src/map.js takes it. */
function unitsOf(name, inputs) {
  const [bias, weights, out] = ["Bias", "Weights", "Out"].map((kind) => numbersOf("density_net", `k${name}${kind}`));
  return out.flatMap((weight, h) => {
    const own = [0, 1, 2, 3].map((i) => (i < inputs ? weights[inputs * h + i] : 0));
    return [...own, weight, ...bias.filter((_, i) => i % out.length === h)];
  });
}

/** Rows of starts, numbers of rows, and others. */
function pack(starts, rows, net) {
  const writer = newWriter(modelsOf(FLAT));
  const list = (numbers, row, before = 0) =>
    numbers.forEach((value, i) => {
      const step = value - (numbers[i - 1] ?? before);
      write(writer, step < 0 ? -2 * step - 1 : 2 * step, row);
    });
  write(writer, starts.length, 0);
  for (const start of starts) start.forEach((edge, i) => write(writer, edge - (start[i - 1] ?? 0), 31 - Math.clz32(256 - (start[i - 1] ?? 0))));
  list(rows.slice(1), 9, rows[0]);
  list(net, 10);
  return Buffer.from(writer.bytes()).toString("base64").replaceAll("=", "");
}

// Kinds of models in the order of src/models.js, and how many rows of each short files know.
const KINDS = { Count: 1, Distance: 1, LumaByEnergy: 1, LumaByClass: 14, A: 4, AByClass: 16, B: 4, BByLuma: 16, ColorSigns: 8 };
Object.assign(KINDS, { V: 8, VByClass: 56, R: 48, RByDirection: 32, ShapeSigns: 4 });
const kinds = Object.entries(KINDS).map(([kind, short]) => [numbersOf("start_tables", `kStart${kind}`), short]);
const numbers = numbersOf("start_tables", "kStarts");
const starts = Array.from({ length: numbers.length / 15 }, (_, i) => numbers.slice(15 * i, 15 * i + 15));
const ofShort = kinds.flatMap(([rows, short]) => rows.slice(0, short));
const ofMap = kinds.flatMap(([rows, short]) => rows.slice(short));
// Starts of short files come first.
const order = [...starts.keys()].sort((one, other) => ofShort.includes(other) - ofShort.includes(one) || one - other);
const renumbered = (rows) => rows.map((row) => order.indexOf(row));
const sorted = order.map((i) => starts[i]);
const count = new Set(ofShort).size;
const net = [...numbersOf("density_net", "kMapBase"), ...unitsOf("Map", 4), ...unitsOf("Own", 3)];
const short = renumbered(ofShort);
const tables = {
  PACKED: pack(sorted.slice(0, count), [0, ...short], []),
  MAPPED: pack(sorted.slice(count), [short.at(-1), ...renumbered(ofMap)], net),
};
const lines = Object.entries(tables).map(([name, text]) => `export const ${name} =\n  "${text}";\n`);
writeFileSync(new URL("src/tables.js", import.meta.url), `// Made by tables.mjs.\n\n${lines.join("\n")}`);
