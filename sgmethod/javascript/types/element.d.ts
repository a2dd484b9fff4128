import type { Preview } from "./encoder.js";

/** Attributes of an <img>, and what an <sg-img> shows and loads beside it. */
export interface Attributes {
  /** Of the photograph; the preview's by default. */
  src?: string | null;
  /** What dataUri() returns, which is shown without JavaScript, and until the element draws; the preview's by default. */
  uri?: string | null;
  /** The address of sg-img.js, for pages that do not load it themselves; the preview's by default. */
  script?: string | null;
  [attribute: string]: string | number | null | undefined;
}

/**
 * An <sg-img> with an <img> inside, as HTML, for templates that take strings. The page's style sheet needs the two rules
 * of sgmethod/sg-img.css; the style attribute holds the placeholder, and what attributes say as well.
 *
 * @param preview what previewOf() or encodePreview() returns, or its stored fields
 * @param attributes of the <img>, which are escaped here: src, alt (empty by default), srcset and so on; width and height
 * are the preview's, and follow each other if one is given; loading is "lazy" and decoding "async" unless given; null
 * leaves an attribute out, and undefined is as if it were not given
 * @throws TypeError if preview is something else
 */
export function elementOf(
  preview: Pick<Preview, "text" | "width" | "height"> & Pick<Attributes, "src" | "uri" | "script">,
  attributes?: Attributes,
): string;
