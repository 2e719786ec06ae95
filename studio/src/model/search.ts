// Keys of the model whose names or descriptions have all words of a search.

import { part } from "./overrides.ts";
import type { Table } from "./pieces.ts";
import type { Schema, Schemas } from "./schema.ts";

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
    if (found.length >= MOST || schema.const !== undefined) return;
    const { form, description } = schemas.field(schema, fallback);
    if (words.every((word) => `${key} ${description}`.toLowerCase().includes(word))) {
      found.push({ key, schema, fallback });
      return;
    }
    if (value === null || value === undefined) return;
    if (form.is === "table") visitTable(key, form.keys, value as Table, fallback);
    else if (form.is === "variants") {
      const variant = form.of.get(String((value as Table)[form.tag]));
      const inner = (fallback as Table | null)?.[form.tag] === (value as Table)[form.tag] ? fallback : null;
      if (variant) visitTable(key, variant.properties ?? {}, value as Table, inner);
    } else if (form.is === "list") (value as unknown[]).forEach((each, k) => visit(part(key, k), form.item, each, undefined));
    else if (form.is === "mapping") {
      for (const [name, each] of Object.entries(value as Table)) visit(part(key, name), form.item, each, undefined);
    }
  };
  const visitTable = (key: string, keys: Record<string, Schema>, value: Table, fallback: unknown): void => {
    const defaults = (typeof fallback === "object" ? fallback : null) as Table | null;
    for (const [name, each] of Object.entries(keys)) {
      visit(part(key, name), each, value[name], defaults && name in defaults ? defaults[name] : each.default);
    }
  };
  visitTable("", schemas.root.properties ?? {}, model, null);
  return found;
}
