// The decoder in a worker, beside the page: it keeps opened files by a number and draws views of them, on white.

import { draw, layOverWhite } from "./drawing.js";
import { readFile } from "./file.js";

const files = new Map();

const answers = {
  open({ key, bytes }) {
    const file = readFile(bytes);
    files.set(key, file);
    return { ...file };
  },
  draw({ key, ...view }) {
    const file = files.get(key);
    const picture = draw(file, view);
    if (file.alpha) layOverWhite(picture);
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
