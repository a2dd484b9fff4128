// The HTML of a photograph with its preview, for templates that take strings.

const ENTITIES = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };

/** An <sg-img> with an <img> inside, as HTML. preview: what encodePreview() returns; attributes: of the <img>, escaped
 * here; null leaves one out; uri: what dataUri() returns, to be seen below the photograph until the preview is drawn. */
export function elementOf({ text, width, height, color }, { src, uri, ...attributes }) {
  if (typeof text !== "string") throw new TypeError("preview must be what encodePreview() returns");
  const style = uri ? `background:${color} url(${uri}) center/cover` : null;
  const all = { src, alt: "", width, height, loading: "lazy", decoding: "async", style, ...attributes };
  return `<sg-img${written({ preview: text })}><img${written(all)}></sg-img>`;
}

const written = (attributes) =>
  Object.entries(attributes)
    .filter(([, value]) => value != null)
    .map(([name, value]) => ` ${name}="${`${value}`.replace(/[&<>"']/g, (letter) => ENTITIES[letter])}"`)
    .join("");
