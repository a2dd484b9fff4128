// No import may stand at the top level here: these declarations are for every file.

declare module "*?preview" {
  const preview: import("./node.js").Made & {
    /** The addresses of the photograph, and of sg-img.js. */
    src: string;
    script: string;
  };
  export default preview;
  /** The photograph with its preview, as HTML: elementOf(). */
  export function element(attributes?: import("./element.js").Attributes): string;
}

// With options, which stand before: "./door.jpg?bytes=64&preview".
declare module "*&preview" {
  export { default, element } from "*?preview";
}
