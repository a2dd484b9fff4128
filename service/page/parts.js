// Helpers for elements of the page, workers and tasks.

export const $ = (id) => document.getElementById(id);

/** A new element: properties, then children, which are elements or text. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in made) made[name] = value;
    else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

const later = new WeakMap(); // parts that are to be refilled, and the timers that do it

/** Replace the children of a part, and keep the focus on the button at the same place. While a button is pressed this
 * waits, since a replaced button is never clicked. */
export function refill(part, children) {
  clearTimeout(later.get(part));
  if (part.querySelector("button:active")) {
    later.set(part, setTimeout(() => refill(part, children), 50));
    return;
  }
  const buttons = () => [...part.querySelectorAll("button")];
  const place = buttons().indexOf(document.activeElement);
  part.replaceChildren(...children);
  if (place >= 0) buttons()[place]?.focus({ preventScroll: true });
}

export const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** A worker that starts with the first call. Each call returns a promise of the answer. */
export class Remote {
  #calls = new Map();
  #next = 0;
  #worker = null;

  constructor(url) {
    this.url = url;
  }

  #start() {
    this.#worker = new Worker(this.url, { type: "module" });
    this.#worker.addEventListener("message", ({ data: { call, value, error } }) => {
      const { done, failed } = this.#calls.get(call);
      this.#calls.delete(call);
      if (error) failed(Object.assign(new Error(error.message), error));
      else done(value);
    });
    this.#worker.addEventListener("error", ({ message }) => {
      if (message) return; // it has started
      for (const { failed } of this.#calls.values()) failed(new Error("A part of this page is missing."));
      this.#calls.clear();
      this.#worker = null;
    });
  }

  ask(name, given) {
    if (!this.#worker) this.#start();
    return new Promise((done, failed) => {
      const call = this.#next++;
      this.#calls.set(call, { done, failed });
      this.#worker.postMessage({ call, name, given });
    });
  }
}

/** Run one call at a time, and of the waiting calls only the last. */
export function latest(task) {
  let [busy, waiting] = [false, null];
  return async function run(...given) {
    if (busy) {
      waiting = given;
      return;
    }
    busy = true;
    try {
      await task(...given);
    } finally {
      busy = false;
      const next = waiting;
      waiting = null;
      if (next) run(...next);
    }
  };
}
