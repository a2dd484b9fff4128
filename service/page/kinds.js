// The format of a file, by its first bytes, before it is sent anywhere.

const text = (bytes, from, to) => String.fromCharCode(...bytes.subarray(from, to));

const REFUSED = [
  [(b) => text(b, 0, 4) === "%PDF", "a PDF"],
  [(b) => text(b, 0, 4) === "\x1aE\xdf\xa3", "a video"],
  [(b) => text(b, 4, 8) === "ftyp" && /^(isom|mp4|qt  |M4V|iso)/.test(text(b, 8, 12)), "a video"],
  [(b) => /^\s*<(\?xml|svg)/.test(text(b, 0, 64)), "an SVG drawing"],
  [(b) => text(b, 0, 2) === "PK", "a ZIP archive"],
  [(b) => text(b, 0, 4) === "8BPS", "a Photoshop file"],
];

const IMAGES = [
  ["PNG", (b) => text(b, 0, 4) === "\x89PNG"],
  ["JPEG", (b) => text(b, 0, 3) === "\xff\xd8\xff"],
  ["GIF", (b) => text(b, 0, 4) === "GIF8"],
  ["WebP", (b) => text(b, 0, 4) === "RIFF" && text(b, 8, 12) === "WEBP"],
  ["AVIF", (b) => text(b, 4, 8) === "ftyp" && /avif|avis/.test(text(b, 8, 32))],
  ["HEIC", (b) => text(b, 4, 8) === "ftyp" && /hei[cmsx]|hev[cx]|mif1|msf1/.test(text(b, 8, 32))],
  ["JPEG XL", (b) => text(b, 0, 12) === "\0\0\0\x0cJXL \r\n\x87\n" || text(b, 0, 2) === "\xff\x0a"],
  ["TIFF", (b) => /^(II\*\0|MM\0\*)/.test(text(b, 0, 4))],
  ["BMP", (b) => text(b, 0, 2) === "BM"],
  ["QOI", (b) => text(b, 0, 4) === "qoif"],
  ["PPM", (b) => /^P[1-6]\s/.test(text(b, 0, 3))],
];

/** Formats that every browser reads, unless the file is damaged or too large. */
export const COMMON = ["PNG", "JPEG", "GIF", "WebP"];

/** { kind: "sg" }, or { kind: "image", format } with its name where that is known; { refused } with a sentence for what no
 * service takes. */
export async function kindOf(file) {
  const bytes = new Uint8Array(await file.slice(0, 64).arrayBuffer());
  if (["\xd3\xc1", "\xd3\xc2"].includes(text(bytes, 0, 2))) return { kind: "sg" };
  for (const [matches, name] of REFUSED) {
    if (matches(bytes)) return { refused: `${file.name} is ${name}, not a photograph. Save it as PNG or JPEG first.` };
  }
  if (bytes.length === 0) return { refused: `${file.name} is empty.` };
  return { kind: "image", format: IMAGES.find(([, matches]) => matches(bytes))?.[0] };
}
