export { elementOf } from "./element.js";

export interface Preview {
  /** For an attribute in HTML; decodePreview() and <sg-img> draw it. */
  text: string;
  /** The .sg file. */
  bytes: ReturnType<Uint8ArrayConstructor["of"]>;
  /** Of the picture, in pixels. */
  width: number;
  height: number;
  /** The average, "#rrggbb", weighted by opacity. */
  color: string;
  /** Whether white text on `color` is easier to read than black. */
  dark: boolean;
}

/** 8-bit RGBA, row by row, as sharp's raw output after ensureAlpha(); or an ImageData in sRGB. */
export type Rgba = Uint8Array | Uint8ClampedArray | ArrayBuffer | { data: Uint8Array | Uint8ClampedArray };

/**
 * A picture as a small WebP or PNG in a data URI, for pages without scripts and for next/image.
 *
 * @param rgba as for encodePreview()
 * @param options characters: maximum length of the URI, 400 by default; sharp: the module, for the best WebP; without
 * it, the URI holds a PNG of at most 32 pixels a side, which is about 1 dB worse
 * @returns the URI; "" if nothing fits, or if the picture has transparency, because the placeholder would show through
 * @throws TypeError if rgba is something else or does not fit width and height, or for an unknown option; RangeError
 * for wrong characters
 */
export function dataUri(
  rgba: Rgba,
  width: number,
  height: number,
  options?: { characters?: number; sharp?: (...given: any[]) => any },
): Promise<string>;

/**
 * Encode a picture of any size in a few hundred bytes; alpha is kept.
 *
 * @param rgba the picture, width x height pixels
 * @param options bytes: maximum size of the file, 16 to 1,024, 200 by default; three become four characters of text
 * @throws TypeError if rgba is something else or does not fit width and height, or for an unknown option; RangeError
 * for wrong bytes
 */
export function encodePreview(
  rgba: Rgba,
  width: number,
  height: number,
  options?: { bytes?: number },
): Preview;
