// Builds the page: node demo/build.mjs CHECKOUT FOLDER.

import { build } from "esbuild";
import assert from "node:assert/strict";
import { copyFileSync, mkdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const [checkout, folder] = process.argv.slice(2);
const page = join(checkout, "service", "page");
const SAMPLES = ["cat", "astronaut", "coffee"];
const repository = process.env.GITHUB_REPOSITORY; // which pages are published from
const address = `${process.env.GITHUB_SERVER_URL}/${repository}`;
const parts = {
  SAMPLES: SAMPLES.map((name) => `<button type="button" aria-pressed="false">${name}</button>`).join("\n"),
  RECIPES: repository ? `<a href="${address}/blob/main/docs/previews.md">docs/previews.md</a>` : "docs/previews.md",
  LINKS: repository ? `<a href="${address}">Source and documentation</a>.` : "",
};

rmSync(folder, { recursive: true, force: true });
mkdirSync(join(folder, "samples"), { recursive: true });
const shared = { bundle: true, minify: true, format: "esm", target: "es2022", legalComments: "none", ignoreAnnotations: true };
await build({ ...shared, entryPoints: ["demo/main.js", "demo/worker.js"], outdir: folder });
await build({ minify: true, entryPoints: ["demo/style.css"], outdir: folder });
const filled = readFileSync("demo/index.html", "utf8").replace(/\b[A-Z]{5,}\b/g, (name) => parts[name] ?? name);
writeFileSync(join(folder, "index.html"), filled);
copyFileSync(join(page, "icon.svg"), join(folder, "icon.svg"));
for (const name of SAMPLES) copyFileSync(join(page, "samples", `${name}.webp`), join(folder, "samples", `${name}.webp`));
const first = ["index.html", "style.css", "main.js", "worker.js", "icon.svg", "samples/cat.webp"];
const sizes = first.map((name) => statSync(join(folder, name)).size);
const sum = sizes.reduce((one, other) => one + other);
console.log(first.map((name, i) => `${name} ${sizes[i]}`).join(", "), `: ${sum} bytes, not compressed`);
const [, most] = readFileSync(join(checkout, "docs", "previews.md"), "utf8").match(/the page loads at most (\d+) kB/);
assert(sum <= 1000 * most, `the page takes more than ${most} kB at first, against docs/previews.md`);
