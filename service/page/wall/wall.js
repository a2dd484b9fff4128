// Photographs as previews, beside other placeholders of at most as many characters; then the photographs themselves.

import "../sgmethod/sg-img.js";
import { element } from "../parts.js";

const NOTES = [
  "All have at most that many bytes; chars are what they take in HTML or JSON. WebP is reduced first, to the size that" +
    " suits it best; BlurHash and ThumbHash are as large as they get.",
  "Six of the photographs are Kodak's, released for unrestricted use.",
];
const FIRST = 1; // of the sizes, the one that is shown first
const blobs = new Map(); // addresses of pictures by their text

/** The address of a picture that is there as text: the page's policy allows no data URIs. */
function addressOf(text) {
  if (!blobs.has(text)) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    blobs.set(text, URL.createObjectURL(new Blob([bytes], { type: "image/webp" })));
  }
  return blobs.get(text);
}

const tile = (shown, name, words, className = "") =>
  element("figure", { className }, shown, element("figcaption", {}, element("b", {}, name), ` ${words}`));

function ours({ src, alt, previews }, size, isLoaded) {
  const shown = element("sg-img", { alt, preview: previews[size], width: 432, height: 288 });
  if (isLoaded) shown.setAttribute("src", `static/${src}`);
  return tile(shown, "sgmethod", `${previews[size].length} chars`, "ours");
}

function placeholder(name, webp, characters, { src }, isLoaded) {
  const shown = element("div", { className: "placeholder" });
  if (webp) shown.append(element("img", { src: addressOf(webp), alt: "" }));
  else shown.append(element("p", { className: "none" }, "No file is that small"));
  if (isLoaded) {
    const attributes = { className: "photograph late", alt: "", loading: "lazy" };
    const photograph = element("img", { ...attributes, src: `static/${src}` });
    photograph.addEventListener("load", () => photograph.classList.remove("late"));
    shown.append(photograph);
  }
  return tile(shown, name, webp ? `${characters} chars` : "");
}

function tilesOf(picture, size, isLoaded) {
  const { webp, blurhash, thumbhash } = picture;
  return [
    ours(picture, size, isLoaded),
    placeholder("WebP", webp[size], webp[size]?.length, picture, isLoaded),
    placeholder("BlurHash", blurhash[size].webp, blurhash[size].characters, picture, isLoaded),
    placeholder("ThumbHash", thumbhash.webp, thumbhash.characters, picture, isLoaded),
  ];
}

/** Fill a part of the page. */
export async function showWall(place) {
  document.head.append(element("link", { rel: "stylesheet", href: "static/wall/wall.css" }));
  const { bytes, pictures } = await (await fetch("static/wall/wall.json")).json();
  let size = FIRST;
  let isLoaded = false;
  const tiles = element("div", { className: "tiles" });
  const load = element("button", { type: "button", className: "button", id: "load-wall" });
  const fill = () => {
    load.textContent = isLoaded ? "Show the previews again" : "Load the photographs";
    tiles.replaceChildren(...pictures.flatMap((picture) => tilesOf(picture, size, isLoaded)));
  };
  const choices = bytes.map((count, i) => {
    const input = element("input", { type: "radio", name: "wall-size", checked: i === size });
    input.addEventListener("change", () => {
      [size, isLoaded] = [i, false];
      fill();
    });
    return element("label", {}, input, element("span", {}, `${count} bytes`));
  });
  load.addEventListener("click", () => {
    isLoaded = !isLoaded;
    fill();
  });
  fill();
  const group = element("span", { className: "group", role: "radiogroup", ariaLabel: "Size of a preview" }, ...choices);
  const hadFocus = place.contains(document.activeElement);
  place.replaceChildren(element("div", { className: "line" }, group, load), tiles);
  for (const words of NOTES) place.append(element("p", { className: "quiet small" }, words));
  if (hadFocus) load.focus(); // the button that had it was replaced
}
