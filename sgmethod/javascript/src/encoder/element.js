// The HTML of a photograph with its preview, for templates that take strings.

const ENTITIES = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };

/** An <sg-img> with an <img> inside, as HTML. preview: what encodePreview() or previewOf() returns; attributes: of the
 * <img>, escaped here; null leaves one out. Some may come with the preview: src; uri: what dataUri() returns, to be seen
 * below the photograph until the preview is drawn; script: the address of sg-img.js, for pages that do not load it. */
export function elementOf(preview, attributes) {
  if (typeof preview?.text !== "string") throw new TypeError("preview must be what encodePreview() returns");
  const { text, width, height, ...its } = preview;
  const given = Object.fromEntries(Object.entries(attributes ?? {}).filter(([, value]) => value !== undefined));
  const { src = its.src, uri = its.uri, script = its.script, ...others } = given;
  const size = { width: scaled(width, others.height, height), height: scaled(height, others.width, width) };
  const placeholder = uri ? `background-image:url(${uri})` : null; // placed by the page's rules
  if (placeholder && others.style) others.style = `${placeholder};${others.style}`;
  const img = { src, alt: "", ...size, loading: "lazy", decoding: "async", style: placeholder, ...others };
  const loader = script ? `<script${written({ type: "module", async: "", src: script })}></script>` : "";
  return `<sg-img${written({ preview: text })}>${loader}<img${written(img)}></sg-img>`;
}

/** A side that keeps the aspect ratio where the other one is given. */
const scaled = (side, given, other) => (given > 0 ? Math.max(Math.round((side * given) / other), 1) : side);

const written = (attributes) =>
  Object.entries(attributes)
    .filter(([, value]) => value != null)
    .map(([name, value]) => ` ${name}="${`${value}`.replace(/[&<>"']/g, (letter) => ENTITIES[letter])}"`)
    .join("");
