// Previews of photographs for build scripts and uploads, kept in a folder. sharp reads the photographs here, since it does
// not like worker threads (github.com/lovell/sharp/issues/2263); the texts are made in some, or here where none start.

import { createHash } from "node:crypto";
import { once } from "node:events";
import { existsSync } from "node:fs";
import { mkdir, readFile, rename, writeFile } from "node:fs/promises";
import { availableParallelism } from "node:os";
import { dirname, join } from "node:path";
import { types } from "node:util";
import { Worker } from "node:worker_threads";
import { dataUri, encodePreview } from "./encoder.js";
import { SgError } from "./preview.js";

export { elementOf } from "./element.js";
export { SgError };

const MAX_SIDE = 1024; // pixels: more than the largest preview shows
const NEEDED = "previews need sharp 0.34 or later, which reads image files: npm install sharp";
const ADDRESS = /^(https?|data|blob):/i; // which no file has

/** A promise of the preview of a photograph: text, uri, width, height, color and dark.
 *
 * photograph: a path, a file URL, or the bytes of an image file; bytes: of the text's file; characters: of uri at most,
 * 0 for none; cache: the folder that keeps previews by content and options, or false. Needs sharp. Throws SgError for
 * bytes or a file in which there is no picture. */
export async function previewOf(photograph, options = {}) {
  if (options === null || typeof options !== "object") throw new TypeError("options must be an object");
  const { bytes = 200, characters = 400, cache = folderOfCache(), ...others } = options;
  for (const name in others) throw new TypeError(`previewOf() has no option ${name}, only bytes, characters and cache`);
  if (!(Number.isInteger(bytes) && bytes >= 16 && bytes <= 1024)) {
    throw new RangeError("bytes must be a whole number from 16 to 1024");
  }
  if (!(typeof characters === "number" && characters >= 0)) {
    throw new RangeError("characters must be a number from 0 on");
  }
  if (cache !== false && typeof cache !== "string") throw new TypeError("cache must be the path of a folder, or false");
  return inTurn(async () => {
    const [name, data] = await named(photograph);
    if (!data.length) throw new SgError(`${name} is empty`);
    if (!cache) return made(data, name, bytes, characters);
    const key = createHash("sha256").update(`${VERSION} ${bytes} ${characters} `).update(data).digest("hex");
    const file = join(cache, `${key}.json`);
    try {
      return JSON.parse(await readFile(file));
    } catch {
      const preview = await made(data, name, bytes, characters);
      await keep(cache, file, JSON.stringify(preview)).catch(() => {}); // where nothing can be written, it is made again
      return preview;
    }
  });
}

/** Where build tools keep what they can make again: in the nearest node_modules, which a workspace may have at its root
 * alone; nowhere without one, as in a server that was bundled. */
function folderOfCache(folder = process.cwd()) {
  const packages = join(folder, "node_modules");
  if (existsSync(packages)) return join(packages, ".cache", "sgmethod");
  return folder !== dirname(folder) && folderOfCache(dirname(folder));
}

const waiting = [];
let running = 0;

/** Do tasks as many at a time as there are processors, so that few photographs are in memory. */
async function inTurn(task) {
  if (running < availableParallelism()) running++;
  else await new Promise((turn) => waiting.push(turn));
  try {
    return await task();
  } finally {
    if (waiting.length) waiting.shift()();
    else running--;
  }
}

/** What an error calls a photograph, and its bytes, which may be of another realm, as in tests. */
async function named(photograph) {
  if (types.isUint8Array(photograph) || types.isAnyArrayBuffer(photograph)) {
    const { buffer = photograph, byteOffset, byteLength } = photograph;
    return ["the photograph", Buffer.from(buffer, byteOffset, byteLength)];
  }
  const isPath = typeof photograph === "string" && !ADDRESS.test(photograph);
  if (isPath || photograph?.protocol === "file:") return [photograph, await readFile(photograph)];
  throw new TypeError("photograph must be a path, a file URL, or the bytes of an image file as a Uint8Array or ArrayBuffer");
}

async function keep(folder, file, text) {
  const unfinished = `${file}.${process.pid}`;
  await mkdir(folder, { recursive: true });
  await writeFile(unfinished, text);
  await rename(unfinished, file);
}

async function made(data, name, bytes, characters) {
  const { default: sharp } = await import("sharp").catch((error) => {
    throw new Error(`${NEEDED} (${error.message})`, { cause: error });
  });
  const photograph = sharp(data, { failOn: "error" }); // not for warnings, of which telephones' photographs have some
  if (!photograph.autoOrient) throw new Error(NEEDED);
  const { size, pixels, width, height } = await read(photograph).catch((error) => {
    throw new SgError(`${name} cannot be read: ${error.message}`, { cause: error });
  });
  const { text, color, dark } = await encoded(pixels, width, height, { bytes });
  const uri = characters ? await dataUri(pixels, width, height, { characters, sharp }) : "";
  return { text, uri, ...size, color, dark };
}

/** The size at which a photograph is displayed, and what previews show of it: upright sRGB with alpha. */
async function read(photograph) {
  const size = (await photograph.metadata()).autoOrient;
  const small = photograph.autoOrient().resize(MAX_SIDE, MAX_SIDE, { fit: "inside", withoutEnlargement: true });
  const rgba = small.toColourspace("srgb").ensureAlpha().raw();
  const { data: pixels, info } = await rgba.toBuffer({ resolveWithObject: true });
  return { size, pixels, width: info.width, height: info.height };
}

const idle = []; // worker threads
let isThere = true; // their file

/** A preview. It is made in this thread where a worker fails, or none starts, as in a server that a bundler made one file
 * of. */
async function encoded(...picture) {
  try {
    if (isThere) return await inWorker(picture);
  } catch (error) {
    if (/MODULE_NOT_FOUND$/.test(error?.code)) isThere = false; // else, the next may do better
  }
  return encodePreview(...picture);
}

async function inWorker(picture) {
  const file = new URL("./sgmethod-worker.js", import.meta.url); // a name that no other package has where all are bundled
  const worker = idle.pop() ?? new Worker(file, { execArgv: [] }); // --eval, say, is not its
  worker.ref();
  worker.postMessage(picture);
  const over = new AbortController();
  const first = ["message", "exit"].map((event) => once(worker, event, over)); // or an error
  const [answer] = await Promise.race(first).finally(() => over.abort());
  if (typeof answer?.text !== "string") {
    worker.terminate();
    throw new Error("the worker made no preview");
  }
  worker.unref(); // an idle one does not keep the process
  idle.push(worker);
  return answer;
}
