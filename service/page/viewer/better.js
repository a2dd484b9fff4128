// Advice: another format that suits the picture better, and a button that takes that file.

import { ask, jobPath } from "../api.js";
import { $, element, refill } from "../parts.js";
import { save } from "../download.js";
import { trouble } from "../status.js";
import { withoutSuffix } from "../words.js";

const FILES = { webp: "lossless WebP", avif: "AVIF" };

/** Which file suits the picture better, and why; the service makes it of the job's image, as long as it has that. */
export function showAdvice({ id, name, job }) {
  const { advice, better } = job?.result ?? {};
  if (!better) return; // another picture is shown by now
  const button = element("button", { type: "button" }, `Save as ${FILES[better]}`);
  button.addEventListener("click", () => take(id, `${withoutSuffix(name)}.${better}`, better));
  refill($("advice"), [`${advice}. `, ...(Date.now() < Date.parse(job.image_expires_at) ? [button] : [])]);
}

async function take(id, name, kind) {
  try {
    save(await (await ask(`${jobPath(id)}/comparison.${kind}`)).blob(), name);
  } catch (error) {
    trouble(error.message);
  }
}
