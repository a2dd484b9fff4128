// The pictures on the page: each is a sample, a file that was opened, or a job of the service.

import { ask, bytesOf, drawn, jobPath, json, submit } from "./api.js";
import { keep, kept } from "./keeping.js";
import { Remote, sleep } from "./parts.js";
import { stateOf } from "./watching.js";

const POLL_MS = 400;
const RETRY_MS = 2000;
const RETRIES = 30;

const decoder = new Remote("/static/decoder/worker.js");
let keys = 0;

/** A view of an opened file, from the worker. */
export const draw = (file, { scale, region = null, count = file.count }) =>
  decoder.ask("draw", { key: file.key, scale, region, count });

const imageOf = ({ data, width }) => createImageBitmap(new ImageData(data, width));

export class Item {
  /** changed: called with the item whenever anything of it is new. */
  constructor(name, changed) {
    Object.assign(this, { name, changed, state: "new", words: "", done: null, trace: [], watched: false });
    this.original = this.decoded = this.sg = this.file = this.id = this.budget = this.job = null;
    this.size = null;
  }

  tell(change = {}) {
    Object.assign(this, change);
    this.changed(this);
  }

  /** The picture that was given; one that the browser cannot show is not shown. */
  async setOriginal(blob) {
    this.source = blob;
    this.originalBytes = blob.size;
    this.original = await createImageBitmap(blob, { premultiplyAlpha: "none" }).catch(() => null);
    if (this.original) this.size = [this.original.width, this.original.height];
    this.tell();
  }

  /** The .sg file: decoded here, or by the service if it is of a kind that is not known here. */
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
    this.tell({ sg, file, decoded, size, note, measured: null, rivals: {}, heat: null, state: "done", words: "" });
  }

  /** Encode the original within a budget. */
  async encode(budget) {
    await this.#working(async () => {
      this.budget = budget;
      this.tell({ state: "sending", words: "Sending the picture", done: null, trace: [], job: null });
      const { id } = await submit(this.source, budget);
      this.id = id;
      keep(id, this.source, this.name);
      await this.#follow();
    });
  }

  /** Go on with a job that is known by its id, as after a reload. */
  async resume(id) {
    await this.#working(async () => {
      this.id = id;
      this.tell({ state: "queued", words: "Looking for the picture" });
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
      if (this.state !== "cancelled") this.tell({ state: "failed", words: error.message, done: null });
    }
  }

  async #follow() {
    for (let tries = 0; ; ) {
      let job;
      try {
        job = await json(jobPath(this.id));
        tries = 0;
      } catch (error) {
        if (this.state === "cancelled") return;
        if (error.status === 404) throw new Error("The service no longer has this picture: it was removed.");
        if (!(error.status >= 500) || ++tries > RETRIES) throw error;
        this.tell({ words: "The service does not answer; trying again" });
        await sleep(RETRY_MS);
        continue;
      }
      if (this.state === "cancelled") return;
      if (job.state === "failed") throw new Error(`It could not be encoded: ${job.error.detail}`);
      const { kind, value } = job.budget;
      this.budget ??= { kind, value, tune: job.tune, timeLimit: null };
      this.originalBytes ??= job.image.bytes;
      if (job.state === "done") {
        await this.setFile(await bytesOf(job.bitstream_url));
        this.tell({ job, trace: job.trace });
        return;
      }
      this.watched = true;
      this.tell({ state: job.state, trace: job.trace, job, ...stateOf(job) });
      await sleep(POLL_MS);
    }
  }

  /** Cancelling is no error. */
  async cancel() {
    const { id } = this;
    this.tell({ state: "cancelled", words: "Nothing was kept of it.", done: null });
    if (id) await ask(jobPath(id), { method: "DELETE" }).catch(() => undefined);
  }

  get busy() {
    return ["sending", "queued", "running"].includes(this.state);
  }

  close() {
    if (this.file) decoder.ask("close", { key: this.file.key });
  }
}
