// Everything that takes time: reading and encoding.

import { encodePreview } from "../src/encoder/encoder.js";
import { reduced, webp } from "./webp.js";

const MOST_PIXELS = 1e6; // more than a preview shows
let picture = null; // ImageData of at most so many pixels

const answers = {
  async open({ blob }) {
    const bitmap = await createImageBitmap(blob, { imageOrientation: "from-image" }).catch(() => {
      throw new Error("This is no picture that your browser can read.");
    });
    const { width, height } = bitmap;
    const scale = Math.min(Math.sqrt(MOST_PIXELS / (width * height)), 1);
    const canvas = reduced(bitmap, Math.max(Math.round(width * scale), 1), Math.max(Math.round(height * scale), 1));
    picture = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    bitmap.close();
    return { width, height };
  },
  preview: ({ bytes }) => encodePreview(picture, picture.width, picture.height, { bytes }).text,
  webp: ({ characters }) => webp(picture, characters),
};

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
