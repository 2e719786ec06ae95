// What is put into the scenario, and taken out of it, as a whole. What is switched off is taken out, and kept to be put in again.

import type { Model } from "../protocol.ts";
import type { State, Studio } from "../state.ts";
import { LISTS, type Off, override, part, type Table, unused, valueAt } from "./overrides.ts";

type Edit = (overrides: string[]) => void;

/** Puts a table into a list, under another name where its own is taken. Returns its key. */
export function putIn({ model, off }: Readonly<State>, { list, name, table, checks }: Off, edit: Edit): string {
  const there = valueAt(model, list) as Table | Table[];
  const names = Array.isArray(there) ? there.map((each) => each.name) : Object.keys(there);
  const free = unused(name, [...names, ...off.filter((each) => each.list === list).map((each) => each.name)]);
  const key = part(list, Array.isArray(there) ? there.length : free);
  const others = Object.entries(checks).map(([check, each]) => override(part("checks", check), each));
  edit([override(key, list === "objects" ? { ...table, name: free } : table), ...others]);
  return key;
}

interface Entry {
  key: string;
  title: string;
}

export function takeOut({ model }: Readonly<State>, entries: readonly Entry[], edit: Edit): void {
  const checks = entries.flatMap(({ key }) => Object.keys(checksOn(key, model)));
  edit([...entries.map(({ key }) => key), ...checks.map((check) => part("checks", check))].map((key) => override(key, null)));
}

/** Takes out, and keeps it. */
export function switchOff(store: Studio, entries: readonly Entry[], edit: Edit): void {
  const { state } = store;
  const gone = entries.map(({ key, title }): Off => {
    const list = LISTS.find((each) => key.startsWith(each))!;
    return { list, name: title, table: valueAt(state.model, key) as Table, checks: checksOn(key, state.model) };
  });
  store.set({ off: [...state.off, ...gone] });
  takeOut(state, entries, edit);
}

/** Puts in again what was switched off. Returns its key. */
export function switchOn(store: Studio, off: Off, edit: Edit): string {
  store.set({ off: store.state.off.filter((each) => each !== off) });
  return putIn(store.state, off, edit);
}

/** Forgets what is there again, after an undo, and all of it when the scenario is another. */
export function keepOff(store: Studio): void {
  let shown = "";
  store.on(["scenario", "model", "edits_pending"], ({ scenario, model, off, edits_pending }) => {
    const isSame = scenario?.name === shown;
    shown = scenario?.name ?? "";
    if (isSame && edits_pending) return; // which take it out
    const left = isSame ? off.filter((each) => !isThere(model, each)) : [];
    if (left.length < off.length) store.set({ off: left });
  });
}

function isThere(model: Model | null, { list, name }: Off): boolean {
  const there = valueAt(model, list) as Table | Table[];
  return Array.isArray(there) ? there.some((each) => each.name === name) : name in there;
}

/** Checks on the values of a function. */
function checksOn(key: string, model: Model | null): Table {
  const all = Object.entries((model?.checks ?? {}) as Table);
  return Object.fromEntries(all.filter(([, each]) => String((each as Table).metric).startsWith(`${key}.`)));
}
