// Bundles src/ into the package's modules in dist/, checks their sizes, compares what they decode, and tries the element
// where nothing can be drawn: node build.mjs.

import { build } from "esbuild";
import { JSDOM } from "jsdom";
import { parseHTML } from "linkedom";
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { copyFileSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { minify } from "terser";
import { decode } from "./src/decoder.js";
import { encodePreview } from "./src/encoder/encoder.js";
import { crc32 } from "./src/header.js";
import { decodePreview } from "./src/preview.js";

// In kB with gzip, by import.
const SIZES = Object.fromEntries(
  [...readFileSync("README.md", "utf8").matchAll(/^\| `"(sgmethod[^"]*)"` \|.*\| ([\d.]+) kB \|$/gm)].map((row) => row.slice(1)),
);
const SAMPLE = "wtIByUwsTlAigCIP2YFWEPX9zcgbOJ4ebv8IV-sG6g"; // with alpha
const TEXTURED = "wqsMZeXg___fvfw-G6scF3GhVT6gasOEAVY";
const VIEW = { scale: 1.5, region: [2, 1, 9, 7], prefix: 0.9 };
// Properties that no user and no browser sees.
const INTERNAL =
  /^(isShort|quantum|background|grey|upright|parts|payload|samples|left|residual|top|sx|sy|dx|dy|lumaRow|vRow|rRow|signsRow|across|down|xBits|yBits|level|part|halvings|columns|block|square|uBits)$/;

const preview = 'export { SgError, decodePreview } from "./src/preview.js";';
const element = 'export { SgImage } from "./src/sg-img.js";';
const decoder = 'export { decode, info } from "./src/decoder.js";';
const encoder = ["encodePreview", "dataUri", "elementOf"]
  .map((name, i) => `export { ${name} } from "./src/encoder/${["encoder", "uri", "element"][i]}.js";`)
  .join("");
const ENTRIES = {
  preview: { contents: preview, isWhole: false },
  "sg-img": { contents: preview + element, isWhole: false },
  decoder: { contents: preview + decoder, isWhole: true },
  all: { contents: preview + element + decoder, isWhole: true },
  encoder: { contents: encoder, isWhole: false },
  element: { contents: 'export * from "./src/encoder/element.js";', isWhole: false },
};
const MODULES_OF_NODE = ["node", "vite", "sgmethod-worker"];
const MODULES = Object.entries(JSON.parse(readFileSync("package.json")).exports)
  .map(([path, { default: file }]) => [path.replace(".", "sgmethod"), file?.slice("./dist/".length, -".js".length)])
  .filter(([, name]) => name);
const IMPORTS = Object.fromEntries(MODULES.map(([path, name]) => [name, path]));

mkdirSync("dist", { recursive: true });
for (const [name, { contents, isWhole }] of Object.entries(ENTRIES)) {
  const bundled = await build({
    stdin: { contents, resolveDir: process.cwd() },
    bundle: true,
    minify: true,
    format: "esm",
    target: "es2022",
    write: false,
    mangleProps: INTERNAL,
    dropLabels: isWhole ? [] : ["WHOLE"],
  });
  const compress = { passes: 3, unsafe_arrows: true };
  const { code } = await minify(bundled.outputFiles[0].text, { module: true, compress });
  writeFileSync(`dist/${name}.js`, code);
  const size = gzipSync(code, { level: 9 }).length;
  console.log(`${name}.js: ${code.length} bytes, ${size} with gzip`);
  const limit = SIZES[IMPORTS[name]];
  assert(size <= 1000 * limit, `${name}.js is larger than README.md says: ${limit} kB with gzip`);
}

// What the cache of previews must not outlive.
const version = createHash("sha256").update(readFileSync("dist/encoder.js")).update(readFileSync("node/node.js"));
await build({
  entryPoints: MODULES_OF_NODE.map((name) => `node/${name}.js`),
  outdir: "dist",
  target: "node20",
  define: { VERSION: JSON.stringify(version.digest("hex").slice(0, 12)) },
});
copyFileSync("node/sg-img.css", "dist/sg-img.css");

/** The names of values that types declare. */
const declared = (name) =>
  [...readFileSync(`types/${name}.d.ts`, "utf8").matchAll(/^export (?:(?:function|class) (\w+)|(?:\* |{(.*)} )from "\.\/(.*)\.js")/gm)]
    .flatMap(([, own, names, other]) => own ?? names?.trim().split(", ") ?? declared(other));
for (const [, name] of MODULES.filter(([, name]) => name !== "vite")) {
  const names = Object.keys(await import(`./dist/${name}.js`));
  assert.deepEqual([...new Set(declared(name))].sort(), names.sort(), `types/${name}.d.ts does not declare what ${name}.js exports`);
}

const { encodePreview: built } = await import("./dist/encoder.js");
const rgba = Uint8Array.from({ length: 4 * 48 * 32 }, (_, i) => (i % 4 < 3 ? (7 * i) & 255 : 255 * (i % 192 < 96)));
assert.deepEqual(built(rgba, 48, 32), encodePreview(rgba, 48, 32), "encoder.js encodes otherwise");

for (const name of Object.keys(ENTRIES).filter((name) => name !== "encoder" && name !== "element")) {
  const built = await import(`./dist/${name}.js`);
  assert.deepEqual(built.decodePreview(SAMPLE), decodePreview(SAMPLE), `${name}.js decodes otherwise`);
  assert.throws(() => built.decodePreview(SAMPLE.slice(0, -4)), built.SgError);
  assert.deepEqual([built.SgError.name, new built.SgError().name], ["SgError", "SgError"], `${name}.js renames SgError`);
  for (const text of built.decode ? [SAMPLE, TEXTURED] : []) {
    const file = Uint8Array.of(0xd3, ...Buffer.from(text, "base64url"));
    assert.deepEqual(built.decode(file, VIEW), decode(file, VIEW), `${name}.js decodes files otherwise`);
  }
}

// Noise is refused or drawn, and soon: without the checks of whole files, a symbol was once searched for ever.
const { decodePreview: drawn, SgError } = await import("./dist/preview.js");
let refused = 0;
let random = 1;
const noise = () => (random = (random * 48271) % 2147483647) >> 8;
for (let i = 0; i < 6000; i++) {
  const payload = Array.from({ length: 8 + (noise() % 60) }, () => noise() & 255);
  payload[3] |= 1; // the first state
  if (i % 4) payload[4] = (noise() % 32) | ((noise() % 4) << 6); // likely classes
  if (i % 4) payload[5] = 0;
  const bytes = Uint8Array.of(0xd3, 0xc2, 0x83, 0, 0xb0, 0x30, 0, 0, ...payload); // 64 x 48 pixels
  const text = Buffer.from([...bytes, crc32(bytes) & 255]).subarray(1).toString("base64url");
  try {
    drawn(text, 16);
  } catch (error) {
    assert(error instanceof SgError, `noise ends in ${error.stack}`);
    refused++;
  }
}
assert(refused > 3000, "noise is not refused");

// What tests of sites run in: no canvas, no animations, and in linkedom and older jsdom no style sheets.
const HTML = `<!doctype html><html><body><sg-img preview="${SAMPLE}"><img src="a.jpg" alt="A cat"></sg-img></body></html>`;
const doms = { jsdom: new JSDOM(HTML, { url: "http://localhost" }).window, linkedom: parseHTML(HTML) };
const complaints = [];
console.warn = (...words) => complaints.push(words);
doms.jsdom.addEventListener("error", ({ message }) => complaints.push(message)); // a listener's
for (const [name, { document, customElements, HTMLElement, Event }] of Object.entries(doms)) {
  Object.assign(globalThis, { document, customElements, HTMLElement });
  const { SgImage } = await import(`./dist/sg-img.js?${name}`);
  const within = document.querySelector("sg-img");
  const alone = Object.assign(document.createElement("sg-img"), { src: "a.jpg", alt: "A dog", preview: SAMPLE });
  document.body.append(alone);
  assert([within, alone].every((one) => one instanceof SgImage), `${name} has no element`);
  const imgs = [within.querySelector("img"), alone.shadowRoot.querySelector("img")];
  await new Promise((done) => setTimeout(done, 50)); // their turns to draw
  for (const img of imgs) img.dispatchEvent(new Event("load"));
  assert.deepEqual(imgs.map((img) => img.getAttribute("alt")), ["A cat", "A dog"]);
  assert.deepEqual(complaints, [], `the element fails in ${name}`);
}
