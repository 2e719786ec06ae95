// Keys of the model whose names or descriptions have all words of a search.

import { part, type Table } from "./overrides.ts";
import { keysOf, type Schema, type Schemas, sameVariant } from "./schema.ts";

export interface Found {
  key: string;
  schema: Schema;
  fallback: unknown;
}

export const MOST = 60; // keys that are listed

/** The topmost keys that fit, in the order of the model; a key within one that fits is not listed again. */
export function search(schemas: Schemas, model: Table, text: string): Found[] {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  const found: Found[] = [];
  const visit = (key: string, schema: Schema, value: unknown, fallback: unknown): void => {
    if (found.length >= MOST) return;
    const { form, description } = schemas.field(schema, fallback);
    if (words.every((word) => `${key} ${description}`.toLowerCase().includes(word))) {
      found.push({ key, schema, fallback });
      return;
    }
    if (value === null || value === undefined) return;
    if (form.is === "table") visitTable(key, form.keys, value as Table, fallback);
    else if (form.is === "variants") {
      const variant = form.of.get(String((value as Table)[form.tag]));
      if (variant) visitTable(key, variant.properties ?? {}, value as Table, sameVariant(fallback, value, form.tag));
    } else if (form.is === "list") (value as unknown[]).forEach((each, k) => visit(part(key, k), form.item, each, undefined));
    else if (form.is === "mapping") {
      for (const [name, each] of Object.entries(value as Table)) visit(part(key, name), form.item, each, undefined);
    }
  };
  const visitTable = (key: string, keys: Record<string, Schema>, value: Table, fallback: unknown): void => {
    for (const [name, each, usual] of keysOf(keys, fallback)) visit(part(key, name), each, value[name], usual);
  };
  visitTable("", schemas.root.properties ?? {}, model, null);
  return found;
}
