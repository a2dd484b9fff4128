// The tools of the large picture: zoom, compare, ellipses, texture, the first bytes alone.

import { countInPart } from "../sgmethod/file.js";
import { $ } from "../parts.js";
import { count, size } from "../words.js";

export class Tools {
  #viewer;
  #file = null;

  /** changed: called when the rest of the page needs an update. */
  constructor(viewer, changed) {
    this.#viewer = viewer;
    this.changed = changed;
    viewer.moved = () => this.#showZoom();
    this.#listen();
  }

  /** Whether the texture of files that have one is drawn. */
  get textured() {
    return $("texture").checked;
  }

  /** Bytes of the file that are drawn; 0 if all are. */
  get part() {
    return this.#file && $("prefix").value < 100 ? this.#bytesInPart() : 0;
  }

  /** Draw the whole file again. */
  whole() {
    $("prefix").value = 100;
  }

  /** Update the tools for a file, or for none. */
  refresh(file) {
    this.#file = this.#viewer.file = file;
    $("ellipses-field").hidden = $("prefix-field").hidden = !file;
    $("texture-field").hidden = !file?.texture;
    $("blink").disabled = !this.#viewer.left || !this.#viewer.right;
    this.#showZoom();
    this.#showWays();
    this.#showPrefix();
  }

  #showZoom() {
    const { left, right, zoom } = this.#viewer;
    $("zoom").textContent = left || right ? `${Math.round(100 * zoom)} %` : "";
  }

  #bytesInPart() {
    const { bytes, payloadBytes } = this.#file;
    return bytes - payloadBytes + Math.ceil(($("prefix").value / 100) * payloadBytes);
  }

  #showPrefix() {
    const [file, viewer] = [this.#file, this.#viewer];
    if (!file) return;
    const part = $("prefix").value / 100;
    viewer.count = countInPart(file, part);
    const gaussians = `${count(viewer.count)} Gaussians`;
    $("prefix-words").textContent = part < 1 ? `${size(this.#bytesInPart())}, ${gaussians}` : `all ${gaussians}`;
    $("prefix").setAttribute("aria-valuetext", $("prefix-words").textContent);
    viewer.redraw();
  }

  #showWays() {
    const viewer = this.#viewer;
    const ellipses = Boolean(this.#file) && $("ellipses").checked;
    if (ellipses && !viewer.drawEllipses) {
      import("./ellipses.js").then(({ drawEllipses }) => {
        viewer.drawEllipses = drawEllipses;
        this.#showWays();
      });
      return;
    }
    Object.assign(viewer, { ellipses, smooth: !$("pixels").checked, textured: this.textured });
    $("legend").hidden = !ellipses;
    viewer.redraw();
  }

  #listen() {
    const viewer = this.#viewer;
    $("zoom-in").addEventListener("click", () => viewer.zoomTo(viewer.zoom * 2));
    $("zoom-out").addEventListener("click", () => viewer.zoomTo(viewer.zoom / 2));
    $("zoom-fit").addEventListener("click", () => viewer.fit());
    for (const id of ["pixels", "ellipses"]) $(id).addEventListener("change", () => this.#showWays());
    $("texture").addEventListener("change", () => this.changed());
    $("prefix").addEventListener("input", () => {
      this.#showPrefix();
      this.changed();
    });
    const peek = (side) => {
      viewer.peek = side;
      $("stage").dataset.peek = side ?? "";
      viewer.redraw();
    };
    const presses = ({ key }) => key === " " || key === "Enter";
    $("blink").addEventListener("pointerdown", () => peek(1));
    $("blink").addEventListener("keydown", (event) => presses(event) && !event.repeat && peek(1));
    $("blink").addEventListener("keyup", (event) => presses(event) && peek(null));
    for (const kind of ["pointerup", "pointerleave", "blur"]) $("blink").addEventListener(kind, () => peek(null));
    addEventListener("blur", () => peek(null));
    const isBlink = ({ key, ctrlKey, metaKey }) => key?.toLowerCase() === "b" && !ctrlKey && !metaKey;
    $("stage").addEventListener("keydown", (event) => {
      if (isBlink(event) && !event.repeat && !$("blink").disabled) peek(viewer.peek === 1 ? 0 : 1);
    });
    addEventListener("keyup", (event) => isBlink(event) && peek(null));
  }
}
