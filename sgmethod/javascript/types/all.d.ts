export * from "./decoder.js";
export * from "./sg-img.js";
