export * from "./preview.js";

export interface View {
  /** Output pixels for a pixel of the picture, 1/64 to 64; 1 by default. */
  scale?: number;
  /** x, y, width and height in pixels of the picture; the whole picture by default. */
  region?: [x: number, y: number, width: number, height: number] | null;
  /** The part of the file that may be used, above 0 to 1; 1 by default. */
  prefix?: number;
  /** Whether texture is drawn; true by default. */
  texture?: boolean;
}

export interface Picture {
  width: number;
  height: number;
  /** RGBA of 8 bits, row by row. */
  data: Uint8ClampedArray;
}

/**
 * Draw an .sg file of version 2, of any size.
 *
 * @throws SgError
 */
export function decode(bytes: Uint8Array, view?: View): Picture;
