// Encodes previews in a worker thread.

import { parentPort } from "node:worker_threads";
import { encodePreview } from "./encoder.js";

parentPort.on("message", (picture) => parentPort.postMessage(encodePreview(...picture)));
