// HTML with a picture and the decoder that draws it.

import { ask } from "./api.js";
import { withoutSuffix } from "./words.js";

const SOURCES = ["header", "tables", "coder", "models", "map", "payload", "file", "planes", "drawing", "decoder"];

/** HTML that shows a picture from its .sg file, without other files. The label is the picture's name. */
export async function snippetOf(item) {
  const sources = await Promise.all(SOURCES.map(async (name) => (await ask(`static/sgmethod/${name}.js`)).text()));
  const decoder = sources
    .join("\n")
    .replace(/^(import|export) \{.*$/gm, "")
    .replace(/^export /gm, "")
    .replace(/^ *(\/\/|\/?\*).*\n/gm, "")
    .replace(/\n\s*\n/g, "\n");
  let binary = "";
  for (const byte of item.sg) binary += String.fromCharCode(byte);
  const [width, height] = item.size;
  const id = `sg-${Math.random().toString(36).slice(2)}`; // one page may hold several
  const name = withoutSuffix(item.name).replace(/[&<>"]/g, (letter) => `&#${letter.charCodeAt(0)};`);
  const size = `width="${width}" height="${height}" style="max-width: 100%; height: auto"`;
  return `<canvas id="${id}" ${size} role="img" aria-label="${name}"></canvas>
<script type="module">
${decoder}
const file = Uint8Array.from(atob("${btoa(binary)}"), (letter) => letter.charCodeAt(0));
const { data } = decode(file);
document.getElementById("${id}").getContext("2d").putImageData(new ImageData(data, ${width}), 0, 0);
</script>
`;
}
