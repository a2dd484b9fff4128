/// <reference path="./imports.d.ts" />
import type { Options } from "./node.js";

/** A plugin for Vite: `import door from "./door.jpg?preview"`. Options of an import win over these. */
export function previews(options?: Pick<Options, "bytes" | "characters">): { name: string; enforce: "pre" };
