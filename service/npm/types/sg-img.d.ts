export * from "./preview.js";

/** <sg-img>: attributes as of <img>, and `preview`, a text. Importing the module defines it. */
export class SgImage extends HTMLElement {}

declare global {
  interface HTMLElementTagNameMap {
    "sg-img": SgImage;
  }
}
