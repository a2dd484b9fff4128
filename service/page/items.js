// The pictures on the page: samples, files that were opened, jobs of the service.

import { ask, bytesOf, drawn, jobPath, json, submit } from "./api.js";
import { keep, kept } from "./storage.js";
import { Remote, sleep } from "./parts.js";
import { budgetOf } from "./upload.js";
import { size } from "./words.js";

const POLL_MS = 400;
const RETRY_MS = 2000;
const RETRIES = 30;
const unread = (format) => `This service cannot read ${format} pictures. Save or share this one as JPEG first.`;

const decoder = new Remote("static/decoder_worker.js");
let keys = 0;

/** Draw a view of an opened file, in the worker. */
export const draw = (file, { scale, region = null, count = file.count, texture = true }) =>
  decoder.ask("draw", { key: file.key, scale, region, count, texture });

/** Remove a job of the service, which may have been removed already. */
const remove = (id) => ask(jobPath(id), { method: "DELETE" }).catch(() => undefined);

export const imageOf = ({ data, width }) => createImageBitmap(new ImageData(data, width));

/** Put a picture over white, as it is shown here. Null if it is opaque. */
function overWhite(image) {
  const { width, height } = image;
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  let alpha = 3; // index of the first alpha that is not opaque
  while (alpha < data.length && data[alpha] === 255) alpha += 4;
  if (alpha >= data.length) return null;
  context.globalCompositeOperation = "destination-over";
  context.fillStyle = "white";
  context.fillRect(0, 0, width, height);
  return canvas.transferToImageBitmap();
}

export class Item {
  #asking = new AbortController(); // aborts requests about its job

  /** changed: called with the item after each change. */
  constructor(name, changed) {
    Object.assign(this, { name, changed, state: "new", words: "", done: null, trace: [] });
    this.original = this.decoded = this.sg = this.file = this.id = this.budget = this.job = null;
    this.size = this.opened = null;
  }

  update(change = {}) {
    if (this.state === "cancelled") return; // which is final
    Object.assign(this, change);
    this.changed(this);
  }

  /** Set the original; it stays hidden if the browser cannot show it. */
  async setOriginal(blob) {
    this.source = blob;
    this.originalBytes = blob.size;
    this.original = await createImageBitmap(blob, { premultiplyAlpha: "none" }).catch(() => null);
    const laid = this.original && this.format !== "JPEG" ? overWhite(this.original) : null;
    this.wasTransparent = Boolean(laid);
    this.original = laid ?? this.original;
    if (this.original) this.size = [this.original.width, this.original.height];
    this.update();
  }

  /** Set the .sg file, decoded here, or by the service if this decoder does not know its version. */
  async setFile(sg) {
    const key = keys++;
    let [file, decoded, note] = [null, null, ""];
    try {
      file = { ...(await decoder.ask("open", { key, bytes: sg })), key };
      decoded = await imageOf(await decoder.ask("draw", { key, scale: 1 }));
    } catch (error) {
      if (!error.unknown) throw error;
      file = null;
      note = `Drawn by the service: ${error.message}.`;
      decoded = await createImageBitmap(await drawn(sg, "png"));
    }
    const size = [decoded.width, decoded.height];
    this.update({ sg, file, decoded, size, note, measured: null, others: {}, smooth: null, state: "done", words: "" });
  }

  /** Open an .sg file, and store it for a reload. */
  async open(file, place = `file-${Math.random().toString(36).slice(2)}`) {
    this.opened = place;
    await this.setFile(new Uint8Array(await file.arrayBuffer()));
    await keep(place, file, this.name);
  }

  /** Open a stored .sg file, as after a reload. */
  async reopen(place) {
    await this.#working(async () => {
      const before = await kept(place);
      if (!before) throw new Error("This browser no longer has this file: open it again.");
      this.name = before.name;
      await this.open(before.file, place);
    });
  }

  /** Encode the original within a budget. */
  async encode(budget) {
    await this.#working(async () => {
      this.budget = budget;
      const words = `Sending ${this.format ? `${this.format}, ` : ""}${size(this.originalBytes)}`;
      this.update({ state: "sending", words, done: null, trace: [], job: null });
      const { id } = await submit(this.source, budget);
      if (this.state === "cancelled") return void (await remove(id));
      this.id = id;
      keep(id, this.source, this.name);
      this.update({ state: "queued", words: "Waiting" });
      await this.#follow();
    });
  }

  /** Follow a job by its id, as after a reload. */
  async resume(id) {
    await this.#working(async () => {
      this.id = id;
      this.update({ state: "queued", words: "Loading the picture" });
      const before = await kept(id);
      if (before) {
        this.name = before.name;
        await this.setOriginal(before.file);
      }
      await this.#follow();
    });
  }

  async #working(task) {
    try {
      await task();
    } catch (error) {
      const refused = error.status === 415;
      const words = refused && this.format ? unread(this.format) : error.message;
      this.update({ state: "failed", words, done: null, refused });
    }
  }

  async #follow() {
    const { stateOf } = await import("./progress.js"); // not needed at first
    for (let tries = 0; ; ) {
      let [job, sg] = [null, null];
      try {
        job = await json(jobPath(this.id), { signal: this.#asking.signal });
        if (job.state === "done") sg = await bytesOf(job.bitstream_url, { signal: this.#asking.signal });
        tries = 0;
      } catch (error) {
        if (this.state === "cancelled") return;
        if (error.status === 404) throw new Error("The service has no such picture, or has deleted it.");
        if (!(error.status >= 500) || ++tries > RETRIES) throw error;
        this.update({ words: "The service does not answer; trying again" });
        await sleep(RETRY_MS);
        continue;
      }
      if (this.state === "cancelled") return;
      if (job.state === "failed") throw new Error(`It could not be encoded: ${job.error.detail}`);
      this.budget ??= budgetOf(job);
      this.originalBytes ??= job.image.bytes;
      if (job.state === "done") {
        Object.assign(this, { job, trace: job.trace });
        return void (await this.setFile(sg));
      }
      this.update({ state: job.state, trace: job.trace, job, ...stateOf(job) });
      await sleep(POLL_MS);
    }
  }

  /** Its name in the address. */
  get place() {
    return this.id ?? this.sample ?? (this.sg ? this.opened : null);
  }

  /** Cancel. own: whether to remove the job as well. */
  async cancel(own = true) {
    const { id } = this;
    this.update({ state: "cancelled", words: "There is no file.", done: null });
    this.#asking.abort();
    if (id && own) await remove(id);
  }

  get busy() {
    return ["sending", "queued", "running"].includes(this.state);
  }

  close() {
    if (this.file) decoder.ask("close", { key: this.file.key });
    const shown = [this.original, this.decoded, this.smooth];
    for (const image of [...shown, ...Object.values(this.others ?? {}).map((other) => other.image)]) image?.close();
    this.original = this.decoded = null;
  }
}
