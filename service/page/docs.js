"use strict";

/** An element with children: elements, texts, or lists of them. */
function make(name, ...children) {
  const element = document.createElement(name);
  element.append(...children.flat());
  return element;
}

/** Words of the document, in which code stands between backticks. */
function prose(words = "") {
  return words.split("`").map((part, place) => (place % 2 ? make("code", part) : part));
}

/** A schema in words. */
function kind(schema) {
  if (schema.$ref) return schema.$ref.split("/").pop();
  if (schema.anyOf) return schema.anyOf.filter((one) => one.type !== "null").map(kind).join(" or ");
  if (schema.enum) return schema.enum.join(", ");
  if (schema.type === "array") return `list of ${kind(schema.items)}`;
  if (schema.format === "binary") return "file";
  const bounds = [];
  if ("exclusiveMinimum" in schema) bounds.push(`above ${schema.exclusiveMinimum}`);
  if ("minimum" in schema) bounds.push(`at least ${schema.minimum}`);
  if ("maximum" in schema) bounds.push(`at most ${schema.maximum}`);
  return [schema.type ?? "any", ...bounds].join(", ");
}

function table(head, rows) {
  if (!rows.length) return [];
  const line = (cells, tag) => make("tr", cells.map((cell) => make(tag, cell)));
  return make("table", make("thead", line(head, "th")), make("tbody", rows.map((row) => line(row, "td"))));
}

function parameters(operation) {
  const rows = (operation.parameters ?? []).map((one) => [
    make("code", one.name),
    one.in,
    kind(one.schema) + ("default" in one.schema ? `; default ${one.schema.default}` : ""),
    prose(one.description ?? one.schema.description),
  ]);
  return table(["parameter", "in", "value", "meaning"], rows);
}

function body(operation) {
  if (!operation.requestBody) return [];
  const rows = Object.entries(operation.requestBody.content).map(([type, { schema }]) => {
    const fields = Object.keys(schema.properties ?? {});
    return [make("code", type), fields.length ? `form of ${fields.join(", ")}` : kind(schema)];
  });
  return [make("p", prose(operation.requestBody.description)), table(["body", "what it is"], rows)];
}

function answers(operation) {
  const rows = Object.entries(operation.responses).map(([status, answer]) => [
    make("code", status),
    prose(answer.description),
    Object.entries(answer.content ?? {}).map(([type, { schema }]) => {
      const named = schema && (schema.$ref || schema.items) ? ` ${kind(schema)}` : "";
      return make("div", make("code", type), named);
    }),
  ]);
  return table(["answer", "meaning", "content"], rows);
}

function section(method, path, operation) {
  const heading = make("summary", make("code", `${method.toUpperCase()} ${path}`), ` ${operation.summary}`);
  const commands = (operation["x-codeSamples"] ?? []).map((sample) => make("pre", make("code", sample.source)));
  const element = make("details", heading, make("p", prose(operation.description)), commands);
  element.append(...[parameters(operation), body(operation), answers(operation)].flat());
  element.id = operation.operationId;
  return element;
}

/** The fields of JSON objects. */
function fields(schemas) {
  return Object.entries(schemas).filter(([, schema]) => schema.properties).map(([name, { description, properties }]) => {
    const rows = Object.entries(properties).map(([field, one]) => [make("code", field), kind(one), prose(one.description)]);
    const heading = make("summary", make("code", name), ` ${description}`);
    return make("details", heading, table(["field", "value", "meaning"], rows));
  });
}

async function show() {
  const problems = document.getElementById("problems"); // the last section
  try {
    const api = await (await fetch("openapi.json")).json();
    const local = (source) => source.replaceAll("http://127.0.0.1:8000/", new URL(".", location).href);
    for (const [path, methods] of Object.entries(api.paths)) {
      for (const [method, operation] of Object.entries(methods)) {
        for (const sample of operation["x-codeSamples"] ?? []) sample.source = local(sample.source);
        problems.before(section(method, path, operation));
      }
    }
    problems.before(...fields(api.components.schemas));
  } catch (error) {
    problems.before(make("p", `the document cannot be read: ${error.message}`));
  }
  const named = location.hash && document.getElementById(location.hash.slice(1));
  if (named) {
    named.closest("details").open = true;
    named.scrollIntoView();
  }
}

show();
