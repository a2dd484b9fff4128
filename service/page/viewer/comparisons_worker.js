// A worker that makes files of other codecs at our size, and measures the distance from the original.

import { largestWithin } from "../sgmethod/encoder/within.js";

const [STEPS, FINE] = [8192, 64]; // of quality, from 0 to 1; 64 change a WebP by a third

let original = null; // { image, data, width, height }

function pixels(image) {
  const context = new OffscreenCanvas(image.width, image.height).getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, image.width, image.height).data;
}

function psnrOf(one, other) {
  let sum = 0;
  for (let i = 0; i < one.length; i += 4) {
    sum += (one[i] - other[i]) ** 2 + (one[i + 1] - other[i + 1]) ** 2 + (one[i + 2] - other[i + 2]) ** 2;
  }
  return sum === 0 ? Infinity : 10 * Math.log10((255 ** 2 * 0.75 * one.length) / sum);
}

/** The mean structural similarity of the luma, in windows of 8 x 8 every 4 pixels. */
function ssimOf(one, other, width, height) {
  const luma = (data, i) => 0.299 * data[i] + 0.587 * data[i + 1] + 0.114 * data[i + 2];
  const [c1, c2] = [(0.01 * 255) ** 2, (0.03 * 255) ** 2];
  let [total, windows] = [0, 0];
  for (let y = 0; y + 8 <= height; y += 4) {
    for (let x = 0; x + 8 <= width; x += 4) {
      let [a, b, aa, bb, ab] = [0, 0, 0, 0, 0];
      for (let j = 0; j < 8; j++) {
        for (let i = 4 * ((y + j) * width + x), end = i + 32; i < end; i += 4) {
          const [p, q] = [luma(one, i), luma(other, i)];
          a += p;
          b += q;
          aa += p * p;
          bb += q * q;
          ab += p * q;
        }
      }
      const [ma, mb] = [a / 64, b / 64];
      const [va, vb, vab] = [aa / 64 - ma * ma, bb / 64 - mb * mb, ab / 64 - ma * mb];
      total += ((2 * ma * mb + c1) * (2 * vab + c2)) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
      windows++;
    }
  }
  return windows ? total / windows : null;
}

function measured(image) {
  const data = pixels(image);
  const { width, height } = original;
  return { psnr: psnrOf(original.data, data), ssim: ssimOf(original.data, data, width, height) };
}

const answers = {
  original({ image }) {
    original = { image, data: pixels(image), width: image.width, height: image.height };
  },
  measure: ({ image }) => measured(image),
  /** The finest file of a type within `bytes`; the next larger, if that one has fewer than `least`. Null if the browser
   * cannot write the type. */
  async encode({ type, bytes, least }) {
    const canvas = new OffscreenCanvas(original.width, original.height);
    canvas.getContext("2d").drawImage(original.image, 0, 0);
    const at = (quality) => canvas.convertToBlob({ type, quality });
    const coarsest = await at(0);
    if (coarsest.type !== type) return null;
    let [under, over] = coarsest.size <= bytes ? [coarsest, null] : [null, coarsest];
    const isNear = () => under?.size >= least;
    const fits = (blob) => {
      if (blob.size <= bytes) under = blob;
      else over = blob;
      return under === blob;
    };
    const between = async (low, high, near) => (await largestWithin((step) => at(step / STEPS), fits, low, high, near))[0];
    if (under) {
      let low = await between(0, STEPS, FINE);
      for (let apart = FINE; apart > 1 && !isNear(); apart /= 2) low = await between(low, low + apart, apart / 2);
    }
    const best = isNear() ? under : (over ?? under);
    const image = await createImageBitmap(best);
    return { image, bytes: best.size, ...measured(image) };
  },
};

addEventListener("message", async ({ data: { call, name, given } }) => {
  try {
    postMessage({ call, value: await answers[name](given) });
  } catch (error) {
    postMessage({ call, error: { message: error.message } });
  }
});
