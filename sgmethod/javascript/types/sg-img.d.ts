export * from "./preview.js";

type ImgProperty =
  | "loading"
  | "decoding"
  | "fetchPriority"
  | "crossOrigin"
  | "referrerPolicy"
  | "alt"
  | "width"
  | "height"
  | "sizes"
  | "srcset"
  | "src";

/** <sg-img>: draws a preview over the <img> inside, or over one of its own, until that has loaded. Importing the module
 * defines the element. */
export class SgImage extends HTMLElement {
  /** What `sgmethod preview` prints. */
  preview: string;
}
/** As on an <img>. Setting them sets attributes of the element, which count if there is no <img> inside. */
export interface SgImage extends Pick<HTMLImageElement, ImgProperty> {}

declare global {
  interface HTMLElementTagNameMap {
    "sg-img": SgImage;
  }
}
