/** 8-bit RGBA, row by row, as the constructor of ImageData takes it. */
export interface Picture {
  width: number;
  height: number;
  data: ReturnType<Uint8ClampedArrayConstructor["of"]>;
}

/** An ImageData where the type exists. */
export type Drawn = typeof globalThis extends { ImageData: { prototype: infer T } } ? T : Picture;

/** A text or a file that cannot be decoded, or a photograph that cannot be read. */
export class SgError extends Error {}

/**
 * Draw a preview of at most 1,024 bytes.
 *
 * @param text what encodePreview() returns, `sgmethod preview` prints and `POST /preview` answers
 * @param size pixels of the longer side of the picture that is returned, 1 to 16,384; 256 by default
 * @returns an ImageData; where there is none, as in Node, an object with the same `width`, `height` and `data`
 * @throws SgError, also for what is no string; RangeError for a wrong size
 */
export function decodePreview(text: string, size?: number): Drawn;
