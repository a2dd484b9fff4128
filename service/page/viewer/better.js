// Advice on a format that suits the picture better, with a button that saves that file.

import { ask, jobPath } from "../api.js";
import { $, element, refill } from "../parts.js";
import { save } from "../download.js";
import { trouble } from "../status.js";
import { withoutSuffix } from "../words.js";

const FILES = { webp: "lossless WebP", avif: "AVIF" };

/** Show the advice, with a button while the service keeps the job's image. */
export function showAdvice({ id, name, job }) {
  const { advice, better } = job?.result ?? {};
  if (!better) return; // another picture is shown by now
  const button = element("button", { type: "button" }, `Save as ${FILES[better]}`);
  button.addEventListener("click", () => take(id, `${withoutSuffix(name)}.${better}`, better));
  const isMade = better === "webp" || job.image.width * job.image.height <= 3e6; // more are too many for an AVIF
  refill($("advice"), [`${advice}. `, ...(isMade && Date.now() < Date.parse(job.image_expires_at) ? [button] : [])]);
}

async function take(id, name, kind) {
  try {
    save(await (await ask(`${jobPath(id)}/comparison.${kind}`)).blob(), name);
  } catch (error) {
    trouble(error.message);
  }
}
