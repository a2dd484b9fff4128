// The HTML of a photograph with its preview, for templates that take strings.

const ENTITIES = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };

/** An <sg-img> with an <img> inside, as HTML. preview: what encodePreview() or previewOf() returns; attributes: of the
 * <img>, escaped here; null leaves one out. Some may come with the preview: src; uri: what dataUri() returns, to be seen
 * below the photograph until the preview is drawn; script: the address of sg-img.js, for pages that do not load it. */
export function elementOf(preview, attributes) {
  if (typeof preview?.text !== "string") throw new TypeError("preview must be what encodePreview() returns");
  const { text, width, height } = preview;
  const { src, uri, script, ...others } = { src: preview.src, uri: preview.uri, script: preview.script, ...attributes };
  const style = uri ? `background-image:url(${uri})` : null; // placed by the page's rules
  const img = { src, alt: "", width, height, loading: "lazy", decoding: "async", style, ...others };
  const loader = script ? `<script${written({ type: "module", async: "", src: script })}></script>` : "";
  return `<sg-img${written({ preview: text })}>${loader}<img${written(img)}></sg-img>`;
}

const written = (attributes) =>
  Object.entries(attributes)
    .filter(([, value]) => value != null)
    .map(([name, value]) => ` ${name}="${`${value}`.replace(/[&<>"']/g, (letter) => ENTITIES[letter])}"`)
    .join("");
