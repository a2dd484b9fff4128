// A plugin for Vite: import door from "./door.jpg?preview".

import { join } from "node:path";
import { isFileLoadingAllowed } from "vite";
import { previewOf } from "./node.js";

/** options: bytes and characters, as of previewOf(), where an import says nothing else. */
export function previews(options = {}) {
  let cache;
  return {
    name: "sgmethod",
    enforce: "pre",
    config: () => ({ optimizeDeps: { exclude: ["sgmethod"] } }), // it would be found late, and reload the page
    configResolved(config) {
      cache = join(config.cacheDir, "sgmethod");
    },
    async load(id) {
      const [path, query] = id.split("?");
      const asked = new URLSearchParams(query);
      if (!asked.has("preview")) return;
      refuseOutside(path, this.environment);
      asked.delete("preview");
      const own = Object.fromEntries([...asked].map(([name, value]) => [name, Number(value)]));
      this.addWatchFile(path);
      return moduleOf(path, await previewOf(path, { ...options, ...own, cache }));
    },
  };
}

/** Throw what Vite answers with 403, if a browser asks a development server for a file that server.fs forbids. */
function refuseOutside(path, { mode, config }) {
  if (mode !== "dev" || config.consumer !== "client" || isFileLoadingAllowed(config, path)) return;
  throw Object.assign(new Error(`${path} is outside of server.fs.allow`), { code: "ERR_DENIED_ID", id: path });
}

/** Where the module runs in a browser, it loads the element; on a server, element() writes its address into the page. It
 * must not say import.meta.env, which Vite 6 and 7 leave as it is in modules that are named like assets. */
const moduleOf = (path, preview) => `
  import src from ${JSON.stringify(`${path}?url`)};
  import script from "sgmethod/sg-img?url&no-inline";
  import "sgmethod/sg-img.css";
  import { elementOf } from "sgmethod/element";
  if (typeof document !== "undefined") import(/* @vite-ignore */ script);
  const preview = { src, script, ...${JSON.stringify(preview)} };
  export default preview;
  export const element = (attributes) => elementOf(preview, attributes);
`;
