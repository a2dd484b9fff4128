import type { ClassAttributes, ImgHTMLAttributes } from "react";
import type { SgImage } from "./sg-img.js";

declare module "react" {
  namespace JSX {
    interface IntrinsicElements {
      "sg-img": ClassAttributes<SgImage> & ImgHTMLAttributes<SgImage> & { preview?: string; class?: string };
    }
  }
}
