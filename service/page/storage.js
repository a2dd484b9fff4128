// State that survives a reload: originals and opened files in the browser's database, the budget and the key.

import { sleep } from "./parts.js";

const MAX_KEPT = 12;
const PATIENCE_MS = 2000; // a browser's database may never answer
const NAME = "sgmethod";

async function opened() {
  const request = indexedDB.open(NAME, 1);
  request.onupgradeneeded = () => request.result.createObjectStore("originals", { keyPath: "id" });
  return finished(request);
}

function finished(request) {
  return new Promise((done, failed) => {
    request.onsuccess = () => done(request.result);
    request.onerror = () => failed(request.error);
  });
}

/** Store the original of a job, or an .sg file, and drop the oldest. Errors of the browser are ignored. */
export async function keep(id, file, name) {
  try {
    const store = (await opened()).transaction("originals", "readwrite").objectStore("originals");
    await finished(store.put({ id, file, name, at: Date.now() }));
    const all = await finished(store.getAll());
    all.sort((one, other) => other.at - one.at);
    for (const old of all.slice(MAX_KEPT)) store.delete(old.id);
  } catch {
    return;
  }
}

/** Load what was stored under an id: { file, name }, or undefined. */
export async function kept(id) {
  const found = opened().then((db) => finished(db.transaction("originals").objectStore("originals").get(id)));
  return Promise.race([found, sleep(PATIENCE_MS)]).catch(() => undefined);
}

/** The browser's storages, or plain objects where site data is blocked. */
export const [local, session] = ["localStorage", "sessionStorage"].map((name) => {
  try {
    return window[name] ?? {};
  } catch {
    return {};
  }
});

export function remembered(input, storage) {
  const name = `sgmethod-${input.id}`;
  input.value = storage[name] ?? input.value;
  input.addEventListener("input", () => (storage[name] = input.value));
}
