// What all controls of keys share: the schema, and the ways to edit.

import type { Acts } from "../protocol.ts";
import type { Schemas } from "./schema.ts";

export interface Editor {
  readonly schemas: Schemas;
  /** Change keys; overrides are `key=value`. */
  edit(...overrides: string[]): void;
  /** Whether an edit of this key is on its way, so that the model is older than the control. */
  busy(key: string): boolean;
  /** When a key acts; null where the server does not say. */
  acts(key: string): Acts | null;
}

/** The controls of a key. */
export interface Node {
  readonly element: HTMLElement;
  /** Show the model's value; null where the key is left out. */
  show(value: unknown): void;
}

/** When a key acts, by the longest beginning of it. */
export function actsOf(key: string, acts: Readonly<Record<string, Acts>>): Acts | null {
  const plain = key.replaceAll(/\[\d+\]/g, "");
  for (let end = plain.length; end > 0; end = plain.lastIndexOf(".", end - 1)) {
    const found = acts[plain.slice(0, end)];
    if (found) return found;
  }
  return acts[""] ?? null;
}
