// Values that are on their way to the server, over the model that it told last.

import type { Model } from "../protocol.ts";
import type { Change } from "./things.ts";

/** A model with other values; what has not changed is shared. */
export function patched(model: Model, changes: Iterable<Change>): Model {
  let made: unknown = model;
  for (const [key, value] of changes) made = withValue(made, key.split(/\.|\[|\]\.?/).filter(Boolean), value);
  return made as Model;
}

function withValue(data: unknown, path: readonly string[], value: unknown): unknown {
  const [first, ...rest] = path;
  if (first === undefined) return value;
  if (Array.isArray(data)) return data.map((each, k) => (String(k) === first ? withValue(each, rest, value) : each));
  if (typeof data !== "object" || data === null) return data;
  return { ...data, [first]: withValue((data as Record<string, unknown>)[first], rest, value) };
}
