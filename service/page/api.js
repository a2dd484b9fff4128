// The service's API, with its errors in plain words.

import { $ } from "./parts.js";

/** An answer other than 2xx. */
class Refusal extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

const WORDS = {
  413: "The picture is too large for this service.",
  429: "The service is busy. Please try again in a moment.",
  503: "The service is overloaded. Please try again in a moment.",
};

const outOfReach = () => {
  throw new Refusal(503, "The service cannot be reached.");
};

export async function ask(path, options = {}) {
  const key = $("key").value.trim();
  if (key) options = { ...options, headers: { ...options.headers, Authorization: `Bearer ${key}` } };
  const response = await fetch(new URL(path, location), options).catch(outOfReach);
  if (response.ok) return response;
  if (response.status === 401) {
    $("key-field").hidden = false;
    $("key").focus();
    throw new Refusal(401, key ? "Unknown API key." : "This service needs an API key.");
  }
  const problem = await response.json().catch(() => ({})); // a proxy's answer may be anything
  const why = problem.detail ? ` (${problem.detail})` : "";
  const words = WORDS[response.status];
  const detail = problem.detail ?? `The service answered ${response.status}.`;
  throw new Refusal(response.status, words ? words + why : detail);
}

export const json = async (path, options) => (await ask(path, options)).json().catch(outOfReach);
export const bytesOf = async (path, options) =>
  new Uint8Array(await (await ask(path, options)).arrayBuffer().catch(outOfReach));
export const hasKey = () => $("key").value.trim() !== "";

export const jobPath = (id) => `jobs/${id}`;

/** What an encode asks for beyond the service's defaults: [name, value] of each. A budget in dB has one tune. */
export function choices({ kind, value, options }) {
  const chosen = Object.entries(options).filter(([name]) => kind !== "psnr" || name !== "tune");
  return kind ? [[kind, value], ...chosen] : chosen;
}

/** Submit a new job. */
export function submit(file, budget) {
  const form = new FormData();
  form.append("image", file);
  for (const [name, value] of choices(budget)) form.append(name, value);
  return json("encode", { method: "POST", body: form });
}

/** Have the service draw a file. width: other than its own. */
export async function drawn(sg, kind, width = null) {
  const query = width ? `?width=${width}` : "";
  return (await ask(`decode.${kind}${query}`, { method: "POST", body: sg })).blob();
}
