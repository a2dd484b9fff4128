// Builds the page: node demo/build.mjs CHECKOUT FOLDER. Snippets are the recipes of docs/previews.md.

import { build } from "esbuild";
import assert from "node:assert/strict";
import { copyFileSync, mkdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const [checkout, folder] = process.argv.slice(2);
const page = join(checkout, "service", "page");
const SAMPLES = ["cat", "astronaut", "coffee"];
const RECIPES = ["Vite", "SvelteKit", "Astro", "Nuxt", "React with Vite", "Next.js", "Eleventy", "Uploads", "FastAPI", "Django"];
const escaped = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");

/** Markdown of a recipe as HTML: paragraphs, lists and code. */
function htmlOf(markdown) {
  const inline = (text) =>
    escaped(text)
      .replace(/\[([^\]]*)\]\([^)]*\)/g, "$1")
      .replace(/`([^`]*)`/g, "<code>$1</code>");
  return markdown
    .trim()
    .split(/^```\w+\n([^]*?)^```$/m)
    .flatMap((part, i) =>
      i % 2
        ? [`<pre tabindex="0"><code>${escaped(part)}</code></pre>`]
        : part.trim().split(/\n\n|\n(?=- )/).filter(Boolean).map((text) => `<p>${inline(text).replace(/^- /, "• ")}</p>`),
    )
    .join("\n");
}

const idOf = (heading) => heading.toLowerCase().replace(/[^a-z]+/g, "-");
const previews = readFileSync(join(checkout, "docs", "previews.md"), "utf8");
const sections = RECIPES.map((heading) => {
  const [, found] = previews.match(new RegExp(`^## ${heading.replace(".", "\\.")}$([^]*?)(?=^## |(?![^]))`, "m"));
  return `<div class="snippet" id="${idOf(heading)}" hidden>${htmlOf(found)}</div>`;
});
const html = `<div class="snippet" id="plain-html"><pre tabindex="0"><code id="element"></code></pre>
  <div class="line"><button type="button" data-copies="element">Copy the HTML</button></div></div>`;
const { pictures } = JSON.parse(readFileSync(join(page, "wall", "wall.json")));
const samples = SAMPLES.map((name) => {
  const { previews: [text] } = pictures.find(({ src }) => src === `samples/${name}.webp`);
  return `<button type="button" data-sample="${name}" aria-pressed="false"><sg-img preview="${text}" alt=""></sg-img><span>${name}</span></button>`;
});
const repository = process.env.GITHUB_REPOSITORY; // which pages are published from
const address = `${process.env.GITHUB_SERVER_URL}/${repository}`;
const parts = {
  SAMPLES: samples.join("\n"),
  OPTIONS: [["plain-html", "HTML"], ...RECIPES.map((heading) => [idOf(heading), heading])]
    .map(([id, name]) => `<option value="${id}">${name}</option>`)
    .join(""),
  SNIPPETS: [html, ...sections].join("\n"),
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
for (const name of SAMPLES) {
  for (const kind of ["webp", "sg"]) copyFileSync(join(page, "samples", `${name}.${kind}`), join(folder, "samples", `${name}.${kind}`));
}
const first = ["index.html", "style.css", "main.js", "worker.js", "icon.svg", "samples/cat.webp", "samples/cat.sg"];
const sizes = first.map((name) => statSync(join(folder, name)).size);
const sum = sizes.reduce((one, other) => one + other);
console.log(first.map((name, i) => `${name} ${sizes[i]}`).join(", "), `: ${sum} bytes, not compressed`);
const [, most] = previews.match(/the page loads at most (\d+) kB/);
assert(sum <= 1000 * most, `the page takes more than ${most} kB at first, against docs/previews.md`);
