// The same as decode.cpp, with the decoder in WebAssembly: node decode.mjs DECODER.JS.
import { readFileSync, writeSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { SgError, decode, info } = await import(pathToFileURL(process.argv[2]));

function write(bytes) {
  for (let at = 0; at < bytes.length; ) at += writeSync(1, bytes, at);
}

function answer(request) {
  const [, ...numbers] = request.match(/^(\S+) (\S+) (\S+) (\S+) (\S+) (\S+) /);
  const path = request.slice(numbers.join(" ").length + 1);
  const [scale, prefix, x, y, width, height] = numbers.map(Number);
  const bytes = new Uint8Array(readFileSync(path));
  const picture = decode(bytes, { scale, prefix, region: width === 0 ? null : [x, y, width, height] });
  const said = info(bytes);
  if (scale === 1 && width === 0 && (said.width !== picture.width || said.height !== picture.height))
    throw new Error("info and decode differ");
  write(Buffer.from(`${picture.width} ${picture.height}\n`));
  write(picture.data);
}

for (const request of readFileSync(0, "utf8").split("\n").filter(Boolean)) {
  try {
    answer(request);
  } catch (error) {
    if (!(error instanceof SgError)) throw error;
    write(Buffer.from(`refused ${error.message}\n`));
  }
}
