// <sg-img src="photo.avif" preview="xY0a..." alt="...">: draws the preview at once, loads the picture lazily, and fades
// it in. srcset, sizes and the other attributes of an <img> are handed on to one; an <img> within is used instead.

import { decodePreview } from "../decoder/preview.js";

const SLICE_MS = 8; // of drawing at a time, so that a page of many stays responsive
const FADE_MS = 300;
// Of an <img>; in the order in which they are handed on: src last, when all is known that it depends on.
const ATTRIBUTES = ["loading", "decoding", "fetchpriority", "crossorigin", "referrerpolicy", "alt", "width", "height"];
ATTRIBUTES.push("sizes", "srcset", "src");
const STYLE = `
:host { display: block; position: relative; overflow: hidden; object-fit: cover }
:host([hidden]) { display: none }
img, ::slotted(img) { display: block; width: 100%; height: 100%; object-fit: inherit; position: relative }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: inherit }`;

const waiting = []; // elements whose preview is to be drawn
let sheet;
let until = 0; // when the present slice ends
let isTimed = false;

/** Draw what waits, a slice at a time. */
function drawSome() {
  isTimed = false;
  until = performance.now() + SLICE_MS;
  drawUntil();
}

function drawUntil() {
  while (waiting.length && performance.now() < until) waiting.shift().draw();
  if (isTimed || !waiting.length) return;
  isTimed = true;
  setTimeout(drawSome);
}

export class SgImage extends (globalThis.HTMLElement ?? Object) {
  static observedAttributes = ["preview", ...ATTRIBUTES];
  #canvas = null;
  #img = null;

  connectedCallback() {
    if (this.shadowRoot) return;
    const root = this.attachShadow({ mode: "open" });
    if (!sheet) (sheet = new CSSStyleSheet()).replaceSync(STYLE);
    root.adoptedStyleSheets = [sheet];
    const slot = document.createElement("slot");
    root.append(slot);
    const own = document.createElement("img");
    own.part = "img";
    own.loading = "lazy";
    own.decoding = "async";
    const find = () => this.#watch(this.querySelector("img") ?? own);
    find();
    slot.addEventListener("slotchange", find); // the parser brings an <img> later
    for (const name of ATTRIBUTES) if (this.hasAttribute(name)) own.setAttribute(name, this.getAttribute(name));
    if (this.#img === own) root.append(own);
  }

  attributeChangedCallback(name, _, value) {
    const img = this.#img;
    if (!img) return;
    if (name === "preview") this.#cover();
    else if (this.contains(img)) return;
    else if (value === null) img.removeAttribute(name);
    else img.setAttribute(name, value);
  }

  #watch(img) {
    if (img === this.#img) return;
    this.#img?.remove();
    this.#img = img;
    if (img.complete && img.naturalWidth) return; // nothing to wait for
    img.addEventListener("load", () => img.decode().then(this.#uncover, this.#uncover));
    this.#cover();
  }

  /** Show the preview, as soon as there is time to draw it. */
  #cover() {
    if (!this.hasAttribute("preview")) return;
    this.#canvas?.remove();
    this.#canvas = document.createElement("canvas");
    waiting.push(this);
    drawUntil();
  }

  /** Called in its turn. */
  draw() {
    const canvas = this.#canvas;
    if (!canvas) return; // the picture came first
    try {
      const preview = decodePreview(this.getAttribute("preview"));
      [canvas.width, canvas.height] = [preview.width, preview.height];
      canvas.getContext("2d").putImageData(preview, 0, 0);
      const img = this.#img;
      if (!img.hasAttribute("width") && !img.hasAttribute("height")) {
        [img.width, img.height] = [preview.width, preview.height];
      }
      img.style.opacity = 0;
      this.shadowRoot.prepend(canvas);
    } catch (error) {
      console.warn("sg-img has no preview:", error.message, this);
    }
  }

  #uncover = () => {
    const canvas = this.#canvas;
    this.#canvas = null;
    this.#img.style.opacity = "";
    if (!canvas?.isConnected) return;
    const duration = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : FADE_MS;
    this.#img.animate([{ opacity: 0 }, { opacity: 1 }], duration).onfinish = () => canvas.remove();
  };
}

if (globalThis.customElements && !customElements.get("sg-img")) customElements.define("sg-img", SgImage);
