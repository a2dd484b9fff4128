export interface Preview {
  /** For an attribute of a page; decodePreview() and <sg-img> draw it. */
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

/**
 * A picture as a small WebP or PNG in a data URI, for pages without scripts and for next/image.
 *
 * @param rgba as for encodePreview()
 * @param options characters: of the URI at most, 400 by default; sharp: the module, which makes the best WebP; without
 * it, there is a PNG of at most 32 pixels a side, which looks about 1 dB worse
 * @returns "" if nothing fits, and for a picture with transparency, since it would show through
 * @throws TypeError for arguments that are no picture
 */
export function dataUri(
  rgba: Uint8Array | Uint8ClampedArray,
  width: number,
  height: number,
  options?: { characters?: number; sharp?: (...given: any[]) => any },
): Promise<string>;

/**
 * Encode a picture in a few hundred bytes; alpha is kept.
 *
 * @param rgba 4 numbers of 8 bits for each pixel, row by row, as sharp's raw output or the data of an ImageData
 * @param options bytes: of the file at most, 16 to 1,024; three become four characters of text; 200 by default
 * @throws TypeError or RangeError for arguments that are no picture
 */
export function encodePreview(
  rgba: Uint8Array | Uint8ClampedArray,
  width: number,
  height: number,
  options?: { bytes?: number },
): Preview;
