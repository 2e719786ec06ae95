// Nested objects as a table of paths and texts.

import { brief } from "./brief.ts";

/** Values of nested objects and lists with their paths. */
export function flat(value: unknown, path = ""): [string, string][] {
  if (Array.isArray(value) && value.every((each) => typeof each !== "object" || each === null)) return [[path, value.map(text).join(", ")]];
  if (typeof value === "object" && value !== null) {
    return Object.entries(value).flatMap(([key, each]) => flat(each, path ? `${path}.${key}` : key));
  }
  return path ? [[path, text(value)]] : [];
}

function text(value: unknown): string {
  if (value === null || value === undefined) return "-";
  if (typeof value === "boolean") return value ? "yes" : "no";
  return typeof value === "number" ? brief(value) : String(value);
}
