// The decoder in a worker: it keeps opened files by number, and draws views of them over white.

import { draw } from "./sgmethod/drawing.js";
import { readFile } from "./sgmethod/file.js";

const files = new Map();

function layOverWhite(data) {
  for (let at = 0; at < data.length; at += 4) {
    const share = data[at + 3] / 255;
    for (let c = 0; c < 3; c++) data[at + c] = data[at + c] * share + 255 * (1 - share);
    data[at + 3] = 255;
  }
}

const answers = {
  open({ key, bytes }) {
    const file = readFile(bytes);
    files.set(key, file);
    return { ...file };
  },
  draw({ key, ...view }) {
    const file = files.get(key);
    const picture = draw(file, view);
    if (file.alpha) layOverWhite(picture.data);
    return picture;
  },
  close({ key }) {
    files.delete(key);
  },
};

addEventListener("message", ({ data: { call, name, given } }) => {
  try {
    const value = answers[name](given);
    postMessage({ call, value }, value?.data ? [value.data.buffer] : []);
  } catch (error) {
    postMessage({ call, error: { message: error.message, unknown: Boolean(error.unknown) } });
  }
});
