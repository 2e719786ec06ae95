// What texts of some keys may name: lists of it, from which fields of these keys propose.

import { h } from "../dom.ts";
import type { Studio } from "../state.ts";

const LISTS = { image: "symbols", model: "lamps", metric: "columns" } as const;
type List = (typeof LISTS)[keyof typeof LISTS];

/** The list that a key's field names, for its attribute `list`; null where there is none. */
export function listOf(key: string): string | null {
  const list = LISTS[key.slice(key.lastIndexOf(".") + 1) as keyof typeof LISTS];
  return list ? idOf(list) : null;
}

/** The lists, which follow the store. */
export function knownLists(store: Studio): HTMLElement[] {
  const element = (list: List) => h("datalist", { id: idOf(list) });
  const [symbols, lamps, columns] = [element("symbols"), element("lamps"), element("columns")];
  const fill = (of: HTMLElement, names: readonly string[]) => of.replaceChildren(...names.map((value) => h("option", { value })));
  store.on(["choices"], ({ choices }) => {
    fill(symbols, choices?.symbols ?? []);
    fill(lamps, choices?.lamps ?? []);
  });
  store.on(["scenario"], ({ scenario }) => fill(columns, scenario?.runs[0]?.columns.map(({ name }) => name) ?? []));
  return [symbols, lamps, columns];
}

function idOf(list: List): string {
  return `known-${list}`;
}
