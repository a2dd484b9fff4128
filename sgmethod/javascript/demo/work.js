// Workers, and what they are asked.

/** A worker that answers one question after the other: ask(name, given) promises its answer. */
export function startWorker() {
  const worker = new Worker("worker.js", { type: "module" });
  const asked = new Map();
  let count = 0;
  const refuseAll = () => {
    for (const { reject } of asked.values()) reject(Object.assign(new Error("not needed any more"), { isStale: true }));
    asked.clear();
  };
  worker.addEventListener("message", ({ data: { call, answer, error } }) => {
    const { resolve, reject } = asked.get(call) ?? {}; // those forgotten have none
    asked.delete(call);
    if (error) reject?.(new Error(error));
    else resolve?.(answer);
  });
  return {
    ask(name, given) {
      return new Promise((resolve, reject) => {
        asked.set(++count, { resolve, reject });
        worker.postMessage({ call: count, name, given });
      });
    },
    /** Nobody waits for the answers to come. */
    forget: refuseAll,
    stop() {
      worker.terminate();
      refuseAll();
    },
  };
}
