// The same as decode.cpp, with the decoder in WebAssembly: node decode.mjs DECODER.JS. Pixels come without their fourth
// byte, which is 255.
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
  const rgb = new Uint8Array(3 * picture.width * picture.height);
  for (let i = 0; i < rgb.length / 3; ++i) {
    rgb.set(picture.data.subarray(4 * i, 4 * i + 3), 3 * i);
    if (picture.data[4 * i + 3] !== 255) throw new Error("a pixel is not opaque");
  }
  write(Buffer.from(`${picture.width} ${picture.height}\n`));
  write(rgb);
}

for (const request of readFileSync(0, "utf8").split("\n").filter(Boolean)) {
  try {
    answer(request);
  } catch (error) {
    if (!(error instanceof SgError)) throw error;
    write(Buffer.from(`refused ${error.message}\n`));
  }
}
