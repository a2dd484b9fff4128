// Two pictures on one canvas with a divider between them, moved and zoomed together.

import { latest } from "../parts.js";

const MAX_ZOOM = 64; // pixels of the screen for a pixel of the picture
const GRAB = 22; // pixels beside the divider where it is caught
const SETTLED_MS = 120;

/**
 * Shows `left` and `right`, each an ImageBitmap of the whole picture or null. `file` and `count` are the Gaussians that
 * the right one is drawn from; `draw` asks the worker for a view of them. `moved` is called when the zoom may be
 * another one.
 */
export class Viewer {
  #pointers = new Map();
  #dragging = null;
  #frame = 0;
  #part = null; // what the worker has drawn: what was wanted, and its image
  #settling = 0;

  constructor(stage, canvas, divider, draw) {
    Object.assign(this, { stage, canvas, divider, moved() {} });
    this.drawEllipses = null; // once they are wanted
    this.context = canvas.getContext("2d", { alpha: false });
    this.size = [1, 1];
    this.left = this.right = this.file = null;
    this.count = 0;
    this.split = 0.5;
    this.peek = null; // 0 or 1: one side alone, for a moment
    this.smooth = this.textured = true;
    this.ellipses = false;
    this.fitted = true;
    this.zoom = 1;
    this.centre = [0.5, 0.5];
    this.askForPart = latest(async (wanted) => {
      const picture = await draw(wanted.file, wanted).catch(() => null);
      if (!picture || wanted.file !== this.file) return;
      const image = await createImageBitmap(new ImageData(picture.data, picture.width));
      this.#part = { ...wanted, image };
      this.redraw();
    });
    this.#listen();
    new ResizeObserver(() => this.resized()).observe(stage);
  }

  /** Show another picture of this size. */
  show(width, height) {
    const same = this.size[0] === width && this.size[1] === height;
    this.size = [width, height];
    this.#part = null;
    if (!same || this.fitted) this.fit();
    else this.redraw();
  }

  resized() {
    const ratio = devicePixelRatio;
    const { width, height } = this.stage.getBoundingClientRect();
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    if (this.fitted) this.fit();
    this.#draw(); // at once: a new size has emptied the canvas
  }

  get fitZoom() {
    const { width, height } = this.canvas;
    return Math.min(width / this.size[0], height / this.size[1], MAX_ZOOM);
  }

  fit() {
    this.fitted = true;
    this.zoom = this.fitZoom;
    this.centre = this.size.map((side) => side / 2);
    this.#moved();
  }

  /** Zoom so that the place under (x, y), in pixels of the canvas, stays there. */
  zoomTo(zoom, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    const least = Math.min(this.fitZoom, 1);
    const next = Math.min(Math.max(zoom, least), MAX_ZOOM);
    const [dx, dy] = [x - this.canvas.width / 2, y - this.canvas.height / 2];
    this.centre[0] += dx / this.zoom - dx / next;
    this.centre[1] += dy / this.zoom - dy / next;
    this.zoom = next;
    this.fitted = Math.abs(next / this.fitZoom - 1) < 1e-3;
    if (this.fitted) this.fit();
    else this.#moved();
  }

  pan(dx, dy) {
    this.centre[0] -= dx / this.zoom;
    this.centre[1] -= dy / this.zoom;
    this.fitted = false;
    this.#moved();
  }

  setSplit(split) {
    this.split = Math.min(Math.max(split, 0), 1);
    this.redraw();
  }

  #moved() {
    this.centre = this.centre.map((place, i) => Math.min(Math.max(place, 0), this.size[i]));
    this.stage.classList.toggle("fitted", this.fitted);
    this.moved();
    this.redraw();
  }

  redraw() {
    if (this.#frame) return;
    this.#frame = requestAnimationFrame(() => {
      this.#frame = 0;
      this.#draw();
    });
  }

  /** Where the picture's corner is, in pixels of the canvas. */
  #corner() {
    const place = (i, side) => Math.round(side / 2 - this.centre[i] * this.zoom);
    return [place(0, this.canvas.width), place(1, this.canvas.height)];
  }

  #draw() {
    const { context, canvas, zoom } = this;
    const [width, height] = [canvas.width, canvas.height];
    const split = this.left && this.right ? (this.peek ?? this.split) : this.right ? 0 : 1;
    const [x, y] = this.#corner();
    const [w, h] = this.size.map((side) => side * zoom);
    const seam = Math.round(split * width);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = getComputedStyle(this.stage).backgroundColor;
    context.fillRect(0, 0, width, height);
    if (this.right && seam < width) {
      this.#clipped(seam, width, () => this.#drawRight(x, y, w, h, seam));
    }
    if (this.left && seam > 0) {
      this.#clipped(0, seam, () => {
        this.#smoothen();
        context.drawImage(this.left, x, y, w, h);
      });
    }
    const both = Boolean(this.left && this.right) && this.peek === null;
    this.divider.hidden = !both;
    this.divider.style.left = `${100 * split}%`;
    this.divider.setAttribute("aria-valuenow", Math.round(100 * split));
  }

  /** Enlarge both sides alike: smoothly, as browsers do, or with hard pixels. */
  #smoothen() {
    this.context.imageSmoothingEnabled = this.smooth || this.zoom < 1;
    this.context.imageSmoothingQuality = "high";
  }

  #clipped(from, to, draw) {
    this.context.save();
    this.context.beginPath();
    this.context.rect(from, 0, to - from, this.canvas.height);
    this.context.clip();
    draw();
    this.context.restore();
  }

  #drawRight(x, y, w, h, seam) {
    const { context, canvas, zoom, file, count } = this;
    const partial = file && count < file.count;
    const fromGaussians = file && (partial || (this.smooth && zoom > 1));
    context.save();
    context.beginPath();
    context.rect(x, y, w, h);
    context.clip();
    this.#smoothen();
    const part = this.#part;
    if (!partial) context.drawImage(this.right, x, y, w, h);
    if (fromGaussians) {
      if (part) context.drawImage(part.image, x + part.x * zoom, y + part.y * zoom, part.w * zoom, part.h * zoom);
      this.#wantPart(x, y);
    }
    const view = { zoom, x: -x / zoom, y: -y / zoom, left: seam, right: canvas.width, height: canvas.height };
    if (this.ellipses) this.drawEllipses(context, file, count, view);
    context.restore();
  }

  /** Ask the worker for what is to be seen, once it stays. */
  #wantPart(x, y) {
    const [width, height] = this.size;
    const left = Math.max(Math.floor(-x / this.zoom), 0);
    const top = Math.max(Math.floor(-y / this.zoom), 0);
    const w = Math.min(Math.ceil((this.canvas.width - x) / this.zoom), width) - left;
    const h = Math.min(Math.ceil((this.canvas.height - y) / this.zoom), height) - top;
    if (w < 1 || h < 1) return;
    const { file, count, textured: texture } = this;
    const scale = Math.min(this.zoom, this.smooth ? MAX_ZOOM : 1);
    const wanted = { file, count, texture, scale, x: left, y: top, w, h, region: [left, top, w, h] };
    const old = this.#part;
    if (old && ["count", "texture", "scale", "x", "y", "w", "h"].every((name) => old[name] === wanted[name])) return;
    clearTimeout(this.#settling);
    this.#settling = setTimeout(() => this.askForPart(wanted), count < file.count ? 0 : SETTLED_MS);
  }

  #place(event) {
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
  }

  #listen() {
    const { stage, divider } = this;
    stage.addEventListener("pointerdown", (event) => this.#down(event));
    stage.addEventListener("pointermove", (event) => this.#move(event));
    for (const kind of ["pointerup", "pointercancel"]) {
      stage.addEventListener(kind, (event) => {
        this.#pointers.delete(event.pointerId);
        this.#dragging = null;
        stage.classList.remove("moving");
      });
    }
    stage.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      this.zoomTo(this.zoom * Math.exp(-event.deltaY * lines * 0.002), ...this.#place(event));
    }, { passive: false });
    stage.addEventListener("dblclick", (event) => {
      if (this.fitted) this.zoomTo(this.zoom * 4, ...this.#place(event));
      else this.fit();
    });
    divider.addEventListener("keydown", (event) => {
      const arrows = { ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02 };
      const steps = { ...arrows, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 };
      if (!(event.key in steps)) return;
      event.preventDefault();
      event.stopPropagation();
      this.setSplit(this.split + steps[event.key]);
    });
    stage.addEventListener("keydown", (event) => this.#key(event));
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = this.canvas.width / 10;
    const doing = {
      "+": () => this.zoomTo(this.zoom * 1.5),
      "=": () => this.zoomTo(this.zoom * 1.5),
      "-": () => this.zoomTo(this.zoom / 1.5),
      0: () => this.fit(),
      1: () => this.zoomTo(1),
      ArrowLeft: () => this.pan(step, 0),
      ArrowRight: () => this.pan(-step, 0),
      ArrowUp: () => this.pan(0, step),
      ArrowDown: () => this.pan(0, -step),
    }[event.key];
    if (!doing) return;
    event.preventDefault();
    doing();
  }

  #down(event) {
    if (event.button !== 0) return;
    const [x, y] = this.#place(event);
    this.stage.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, [x, y]);
    const near = Math.abs(x - this.split * this.canvas.width) < GRAB * devicePixelRatio;
    this.#dragging = this.#pointers.size === 1 && near && !this.divider.hidden ? "divider" : "picture";
    this.stage.classList.toggle("moving", this.#dragging === "picture");
  }

  #move(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const [x, y] = this.#place(event);
    if (this.#pointers.size === 2) {
      const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const apart = (place) => Math.max(Math.hypot(place[0] - other[0], place[1] - other[1]), 1);
      this.pan((x - before[0]) / 2, (y - before[1]) / 2);
      this.zoomTo((this.zoom * apart([x, y])) / apart(before), (x + other[0]) / 2, (y + other[1]) / 2);
    } else if (this.#dragging === "divider") this.setSplit(x / this.canvas.width);
    else if (!this.fitted || event.pointerType === "mouse") this.pan(x - before[0], y - before[1]);
    this.#pointers.set(event.pointerId, [x, y]);
  }
}
