// The tools of the large picture: zoom, compare, overlays, texture, the first bytes alone.

import { countInPart } from "../sgmethod/file.js";
import { $ } from "../parts.js";
import { count, size } from "../words.js";

const overlays = () => [...document.querySelectorAll("[name=overlay]")];

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
    $("overlays").hidden = $("prefix-field").hidden = !file;
    $("texture-field").hidden = !file?.texture;
    $("blink").disabled = !this.#viewer.left || !this.#viewer.right;
    this.#showZoom();
    this.#showOverlay();
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

  #showOverlay() {
    const [file, viewer] = [this.#file, this.#viewer];
    const overlay = overlays().find((input) => input.checked).value;
    if (overlay !== "none" && !viewer.overlays) {
      import("./overlays.js").then((module) => {
        viewer.overlays = module;
        this.#showOverlay();
      });
      return;
    }
    Object.assign(viewer, { overlay, smooth: !$("pixels").checked, textured: this.textured });
    if (overlay === "heat" && file && !file.heat) file.heat = viewer.overlays.heatOf(file);
    viewer.heat = file?.heat ? (file.heat.picture ??= viewer.overlays.heatPicture(file.heat)) : null;
    $("legend").textContent = {
      none: "",
      ellipses: "Each ellipse is a Gaussian at one standard deviation. Orange ones add light, blue ones remove it.",
      heat: `Bits per pixel: dark is none, pale yellow ${file?.heat?.max.toFixed(1)} bits per pixel or more.`,
    }[file ? overlay : "none"];
    $("legend").hidden = !$("legend").textContent;
    viewer.redraw();
  }

  #listen() {
    const viewer = this.#viewer;
    $("zoom-in").addEventListener("click", () => viewer.zoomTo(viewer.zoom * 2));
    $("zoom-out").addEventListener("click", () => viewer.zoomTo(viewer.zoom / 2));
    $("zoom-fit").addEventListener("click", () => viewer.fit());
    for (const input of [$("pixels"), ...overlays()]) input.addEventListener("change", () => this.#showOverlay());
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
