import type { Picture } from "./preview.js";

export * from "./preview.js";

export type Bytes = Uint8Array | Uint8ClampedArray | ArrayBuffer;

export interface View {
  /** Output pixels for a pixel of the picture, 1/64 to 64; 1 by default. */
  scale?: number;
  /** Instead of a scale: the output is as large as fits into so many pixels. Give either or both. */
  width?: number;
  height?: number;
  /** x, y, width and height in pixels of the picture; the whole picture by default. */
  region?: [x: number, y: number, width: number, height: number] | null;
  /** The part of the file that may be used, above 0 to 1; 1 by default. */
  prefix?: number;
  /** Whether to draw texture; true by default. */
  texture?: boolean;
}

export interface Info {
  /** Of the picture, in pixels. */
  width: number;
  height: number;
  /** Including those of alpha. */
  gaussians: number;
  alpha: boolean;
  texture: boolean;
}

/**
 * Draw an .sg file of version 2, of any size.
 *
 * @throws SgError; TypeError for what are no bytes, for an unknown option, or a scale beside a width or height;
 * RangeError for a wrong prefix
 */
export function decode(bytes: Bytes, view?: View): Picture;

/**
 * Read what a file contains, without drawing it.
 *
 * @throws SgError; TypeError for what are no bytes
 */
export function info(bytes: Bytes): Info;
