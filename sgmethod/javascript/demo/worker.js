// Everything that takes time: reading, encoding, drawing.

import { decode, info } from "../src/decoder.js";
import { encodeFile, encodePreview } from "../src/encoder/encoder.js";
import { blurhash, thumbhash, webp } from "./placeholders.js";

const MOST_PIXELS = 1e6; // more than a file of this page shows
let picture = null; // ImageData of at most so many pixels

const answers = {
  async open({ blob }) {
    const bitmap = await createImageBitmap(blob, { imageOrientation: "from-image" }).catch(() => {
      throw new Error("This is no picture that your browser can read.");
    });
    const { width, height } = bitmap;
    const scale = Math.min(Math.sqrt(MOST_PIXELS / (width * height)), 1);
    picture = reduced(bitmap, Math.max(Math.round(width * scale), 1), Math.max(Math.round(height * scale), 1));
    bitmap.close();
    return { width, height };
  },
  preview: ({ bytes }) => encodePreview(picture, picture.width, picture.height, { bytes }),
  webp: ({ characters }) => webp(picture, characters),
  blurhash: ({ characters }) => blurhash(picture, characters),
  thumbhash: () => thumbhash(picture),
  file: ({ bytes }) => encodeFile(picture, picture.width, picture.height, bytes)[0],
  info: ({ file }) => info(file),
  view: ({ file, ...view }) => decode(file, view),
};

function reduced(bitmap, width, height) {
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, 0, 0, width, height);
  return context.getImageData(0, 0, width, height);
}

let last = Promise.resolve(); // so that a question waits for those before it
addEventListener("message", ({ data: { call, name, given } }) => {
  last = last.then(async () => {
    try {
      postMessage({ call, answer: await answers[name](given) });
    } catch (error) {
      postMessage({ call, error: error.message });
    }
  });
});
