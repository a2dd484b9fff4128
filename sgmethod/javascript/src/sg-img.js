// <sg-img preview="wo0a..."><img src="photo.avif" width height></sg-img>: draws the preview over the photograph, and
// fades it out once that has loaded. Without an <img> inside, the element takes src, alt and so on itself, as an <img>
// does. It draws in its shadow tree, and does not change the page's own elements.

import { decodePreview } from "./preview.js";

const SLICE_MS = 8; // of drawing at a time, so that a page of many stays responsive
const FADE_MS = 300;
const NEAR = "50%"; // of the viewport's sides
// Properties of an <img>; in lower case, its attributes.
const OF_IMG = "loading decoding fetchPriority crossOrigin referrerPolicy alt width height sizes srcset src".split(" ");
const SHADOW_STYLE = `
:host { display: grid; grid: minmax(0, 1fr) / minmax(0, 1fr); height: min-content; object-fit: cover }
:host([hidden]), [hidden] { display: none }
div { display: grid; grid: minmax(0, 1fr) / minmax(0, 1fr); position: relative; height: 100%;
  overflow: hidden; border-radius: inherit }
img, canvas, ::slotted(*) { grid-area: 1 / 1; min-width: 100%; max-width: 100%; height: 100% }
div, slot, img, canvas, ::slotted(*) { object-fit: inherit; object-position: inherit }
::slotted(picture) { display: contents }
canvas { position: absolute; pointer-events: none }
img:not([src], [srcset]) { opacity: 0 } /* or a browser's sign of a broken image shows through */
@media print { canvas { display: none } }`;
// For what ::slotted() does not reach. The page's own rules win, because they are in no layer; but a placeholder, which
// would stay beside a photograph that does not fill its box, goes when there is more to see.
const PAGE_STYLE = `@layer { sg-img > picture > img {
  grid-area: 1 / 1; min-width: 100%; max-width: 100%; height: 100%; object-fit: inherit; object-position: inherit }
sg-img:state(--shown) img[style*="data:image/"] { background-image: none !important } }`;

const waiting = new Set(); // elements' turns to draw, in order
const sheets = new WeakMap(); // by document, since a style sheet belongs to one

function later(turn) {
  waiting.add(turn);
  if (waiting.size === 1) setTimeout(takeTurns);
}

function takeTurns() {
  const until = performance.now() + SLICE_MS;
  for (const turn of waiting) {
    waiting.delete(turn); // first: one that throws must not be in the way of the others
    try {
      turn();
    } catch (error) {
      reportError(error);
    }
    if (performance.now() > until) break;
  }
  if (waiting.size) setTimeout(takeTurns);
}

function sheetsOf(page) {
  if (!sheets.has(page)) {
    const { CSSStyleSheet } = page.defaultView;
    const made = [SHADOW_STYLE, PAGE_STYLE].map((text) => {
      const sheet = new CSSStyleSheet();
      sheet.replaceSync(text);
      return sheet;
    });
    sheets.set(page, made);
  }
  return sheets.get(page);
}

export class SgImage extends (globalThis.HTMLElement ?? Object) {
  static observedAttributes = ["preview", ...OF_IMG.map((name) => name.toLowerCase())];
  static #viewport =
    globalThis.IntersectionObserver &&
    new IntersectionObserver(
      (entries) => {
        for (const { target, isIntersecting } of entries) {
          target.#isNear = isIntersecting;
          later(target.#update);
        }
      },
      { rootMargin: NEAR, scrollMargin: NEAR },
    );
  #own = document.createElement("img");
  #frame = document.createElement("div");
  #canvas = null; // shows the preview until the photograph is there
  #drawn = null; // the text of that preview, or one that is damaged
  #isNear = false; // to the viewport: a canvas takes a thousand times the memory of its text
  #states = this.attachInternals?.().states; // old Chromium takes no states without dashes; jsdom has none

  static {
    for (const name of ["preview", ...OF_IMG]) {
      Object.defineProperty(this.prototype, name, {
        configurable: true,
        enumerable: true,
        get() {
          return name === "preview" ? (this.getAttribute(name) ?? "") : this.#img[name];
        },
        set(value) {
          if (value == null) this.removeAttribute(name);
          else this.setAttribute(name, value);
        },
      });
    }
  }

  constructor() {
    super();
    Object.assign(this.#own, { part: "img", loading: "lazy", decoding: "async" });
    const slot = document.createElement("slot");
    this.#frame.append(slot, this.#own);
    const root = this.attachShadow({ mode: "open" });
    root.append(this.#frame);
    const decoded = () => this.#img.decode?.().then(this.#update, this.#update);
    root.addEventListener("load", decoded, true); // of an <img> of the page too
    slot.addEventListener("slotchange", () => later(this.#update)); // the parser brings an <img> later
  }

  connectedCallback() {
    for (const name of ["preview", ...OF_IMG]) {
      if (!Object.hasOwn(this, name)) continue;
      const value = this[name]; // set before this module had loaded
      delete this[name];
      this[name] = value;
    }
    const page = this.getRootNode();
    // A document without a window draws nothing, nor does a DOM without style sheets, such as linkedom's.
    if (!this.ownerDocument.defaultView || !page.adoptedStyleSheets) return;
    const [shadowSheet, pageSheet] = sheetsOf(this.ownerDocument);
    this.shadowRoot.adoptedStyleSheets = [shadowSheet];
    if (!page.adoptedStyleSheets.includes(pageSheet)) page.adoptedStyleSheets.push(pageSheet);
    SgImage.#viewport?.observe(this);
    later(this.#update);
  }

  attributeChangedCallback(name, _, value) {
    if (name === "preview") later(this.#update);
    else if (this.#img !== this.#own) return;
    else if (value === null) this.#own.removeAttribute(name);
    else this.#own.setAttribute(name, value);
  }

  get #img() {
    return this.querySelector("img") ?? this.#own;
  }

  /** Bring the preview in line with the photograph, whatever has happened to either. */
  #update = () => {
    if (!this.isConnected || !this.animate) return; // jsdom and its like have no canvas either
    const [img, text] = [this.#img, this.preview];
    this.#own.hidden = img !== this.#own;
    const isLoaded = img.complete && img.naturalWidth > 0;
    // The canvas reserves the space if the photograph does not; then it stays.
    const isSized = img.hasAttribute("width") && img.hasAttribute("height");
    if (!text || isLoaded || (isSized && !this.#isNear)) this.#uncover();
    else if (text !== this.#drawn) this.#draw(text, isSized);
    this.#states?.[isLoaded || this.#canvas ? "add" : "delete"]("--shown");
  };

  #draw(text, isSized) {
    try {
      const preview = decodePreview(text);
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [preview.width, preview.height];
      canvas.getContext("2d").putImageData(preview, 0, 0);
      if (!isSized) canvas.style.position = "static";
      this.#canvas?.remove();
      this.#frame.append(canvas);
      [this.#canvas, this.#drawn] = [canvas, text];
    } catch (error) {
      this.#uncover();
      this.#drawn = text; // one warning is enough
      console.warn("sg-img has no preview:", error.message, this);
    }
  }

  #uncover() {
    const canvas = this.#canvas;
    if (!canvas) return;
    this.#canvas = this.#drawn = null;
    canvas.style.opacity = 0; // also if the animation is cancelled
    const duration = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : FADE_MS;
    canvas.animate([{ opacity: 1 }, { opacity: 0 }], duration).onfinish = () => canvas.remove();
  }
}

if (globalThis.customElements && !customElements.get("sg-img")) customElements.define("sg-img", SgImage);
