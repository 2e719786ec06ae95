// The menu "Add": choose what, then click where.

import { h } from "../dom.ts";
import { putIn } from "../model/entries.ts";
import type { List, Table } from "../model/overrides.ts";
import { type Addable, addables } from "./new.ts";
import type { Placing } from "./placing.ts";
import { spotAt } from "./spot.ts";
import { clickWay } from "./way.ts";

export interface Adding {
  element: HTMLElement;
  show(): void;
}

export function addMenu(placing: Placing, toast: (sentence: string) => void): Adding {
  const choice = h("select", { "aria-label": "Add", title: "Choose what to add, then click where" });
  let offered: readonly Addable[] = [];
  const fill = (symbols: readonly string[]) => {
    const groups = addables(symbols);
    offered = groups.flatMap(([, each]) => each);
    choice.replaceChildren(
      h("option", { value: "" }, "Add ..."),
      ...groups.map(([label, each]) => h("optgroup", { label }, ...each.map(({ name }) => h("option", { value: name }, name)))),
    );
  };
  placing.store.on(["choices"], ({ choices }) => fill(choices?.symbols ?? []));
  choice.addEventListener("change", () => {
    const what = offered.find(({ name }) => name === choice.value);
    choice.value = "";
    choice.blur();
    if (!what) return;
    if (what.way) clickWay(placing, what.name, null, (spots) => add(placing, what.into, what.way!(spots), nameOf(what, what.way!(spots))));
    else placing.await({ say: `${what.say} Esc: do not add.`, click: (x, y) => place(placing, what, x, y, toast) });
  });
  return {
    element: choice,
    show: () => {
      choice.disabled = !placing.steers;
    },
  };
}

function place(placing: Placing, what: Addable, x: number, y: number, toast: (sentence: string) => void): void {
  const spot = spotAt(placing, x, y);
  if (!spot) return;
  const table = what.make(spot);
  if (!table) {
    toast(
      spot.object ? "This object has no category, so trackers do not report it: give it one first." : "There is no object; click on one.",
    );
    return;
  }
  placing.await(null);
  add(placing, what.into, table, nameOf(what, table));
}

/** Adds a table to the model, and chooses it. */
export function add(placing: Placing, list: List, table: Table, name: string): void {
  placing.afterEdits(() => placing.choose(putIn(placing.store.state, { list, name: plain(name), table, checks: {} }, placing.change)));
}

/** What it is called: functions by their picture or kind. */
function nameOf({ into, name }: Addable, table: Table): string {
  return into === "functions" ? String(table.image ?? table.kind) : name;
}

/** A name of small letters and underscores. */
function plain(name: string): string {
  return name
    .replace(/^symbol: |,.*$/g, "")
    .replaceAll(/\W+/g, "_")
    .toLowerCase();
}
