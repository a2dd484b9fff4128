import type { Preview } from "./encoder.js";

export { elementOf } from "./element.js";
export { SgError } from "./preview.js";

export interface Options {
  /** Maximum size of the file in `text`, 16 to 1,024; 200 by default. */
  bytes?: number;
  /** Maximum length of `uri`; 400 by default, 0 for none. */
  characters?: number;
  /** The folder that keeps previews by content and options; false for none. By default, .cache/sgmethod in the nearest
   * folder node_modules, at the working directory or above, if there is one. */
  cache?: string | false;
}

export interface Made extends Omit<Preview, "bytes"> {
  /** A small WebP for readers without JavaScript; "" if the photograph has transparency. */
  uri: string;
}

/**
 * The preview of a photograph, made in a worker thread, or in this one where none starts. Needs sharp 0.34 or later.
 *
 * @param photograph a path, a file URL, or the bytes of an image file, such as a Buffer
 * @throws SgError if the bytes or the file hold no picture that sharp reads; Error if there is no such file, or if sharp
 * is missing; TypeError for something else than a photograph, for an unknown option or a wrong cache; RangeError for
 * wrong bytes or characters
 */
export function previewOf(photograph: string | URL | Uint8Array | ArrayBuffer, options?: Options): Promise<Made>;
