// What can be done with what is chosen: duplicate, remove, switch off and on, and for objects a course.

import { Matrix4, Vector3 } from "three";
import { h } from "../dom.ts";
import { override, valueAt } from "../model/overrides.ts";
import { add } from "./add.ts";
import { giveCourse, halt } from "./course.ts";
import { patched } from "./drafts.ts";
import type { Table } from "./functions.ts";
import type { Addable } from "./new.ts";
import type { Placing } from "./placing.ts";
import type { Thing } from "./things.ts";

/** Something that was taken out of the model and can be put back. */
export interface Off {
  title: string;
  into: Addable["into"];
  table: Table;
}

export interface Deeds {
  element: HTMLElement;
  off: Off[];
  show(): void;
  offRow(off: Off): HTMLElement;
  remove(): void;
  duplicate(): void;
}

const BESIDE_M = 1; // of a copy

export function deeds(placing: Placing): Deeds {
  const off: Off[] = [];
  const wholes = () => placing.chosen.filter(canGo);
  const take = (taken: (all: Off[]) => void) =>
    placing.afterEdits(() => {
      const { model } = placing.store.state;
      const gone = wholes();
      placing.choose(null);
      if (!gone.length) return;
      placing.change(gone.map(({ key }) => override(key, null)));
      taken(gone.map((thing) => ({ title: thing.title, into: listOf(thing)!, table: valueAt(model, thing.key) as Table })));
    });
  const remove = () => take(() => {});
  const switchOff = () =>
    take((all) => {
      off.push(...all);
      placing.refresh();
    });
  const duplicate = () => {
    for (const thing of wholes()) copy(placing, thing);
  };
  const button = (text: string, title: string, onclick: () => void) => h("button", { type: "button", title, onclick }, text);
  const ofOne = (does: (placing: Placing, thing: Thing) => void) => () => {
    const [thing] = placing.chosen;
    if (thing) does(placing, thing);
  };
  const courses = [
    button("Course", "Click the way of this object on the road; it goes from now on", ofOne(giveCourse)),
    button("Halt", "Let it stand where it is now", ofOne(halt)),
  ];
  const whole = [
    button("Duplicate", "A copy beside it (Shift+D)", duplicate),
    button("Switch off", "Take it out, and keep it in this list to put it back", switchOff),
    button("Remove", "Take it out (Delete)", remove),
  ];
  let scenarioName = "";
  placing.store.on(["scenario"], ({ scenario }) => {
    if (scenario?.name !== scenarioName) off.length = 0;
    scenarioName = scenario?.name ?? "";
  });
  return {
    element: h("div", { class: "things-row" }, ...courses, ...whole),
    off,
    remove,
    duplicate,
    show() {
      const any = wholes().length > 0;
      for (const each of whole) each.disabled = !any || !placing.steers;
      const [thing] = placing.chosen;
      for (const each of courses) {
        each.hidden = thing?.sort !== "object" || thing.partOf !== null;
        each.disabled = placing.chosen.length !== 1 || !placing.steers;
      }
    },
    offRow: (each) =>
      h(
        "button",
        {
          type: "button",
          class: "thing off",
          title: "Switch on",
          disabled: !placing.steers,
          onclick: () => {
            off.splice(off.indexOf(each), 1);
            add(placing, each.into, each.table, each.title);
          },
        },
        h("span", { class: "name" }, each.title),
        h("span", { class: "muted" }, "switch on"),
      ),
  };
}

function canGo(thing: Thing): boolean {
  return listOf(thing) !== null;
}

/** List or table that has it as a whole. */
function listOf({ key, partOf }: Thing): Addable["into"] | null {
  const found = (["functions", "objects", "light.street_lamps", "spots"] as const).find((each) => key.startsWith(each));
  return partOf ? null : (found ?? null);
}

function copy(placing: Placing, thing: Thing): void {
  const beside = new Matrix4().makeTranslation(0, BESIDE_M, 0).multiply(thing.T);
  const moved = patched(placing.store.state.model!, thing.changes(beside, new Vector3(1, 1, 1)));
  add(placing, listOf(thing)!, valueAt(moved, thing.key) as Table, thing.title);
}
