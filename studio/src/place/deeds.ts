// What can be done with what is chosen: duplicate, remove, switch off and on, and for objects a course.

import { Matrix4, Vector3 } from "three";
import { h } from "../dom.ts";
import { switchOff, switchOn, takeOut } from "../model/entries.ts";
import { LISTS, type List, type Off, patched, type Table, valueAt } from "../model/overrides.ts";
import { add } from "./add.ts";
import { giveCourse, halt } from "./course.ts";
import type { Placing } from "./placing.ts";
import type { Thing } from "./thing.ts";

export interface Deeds {
  element: HTMLElement;
  show(): void;
  offRow(off: Off): HTMLElement;
  remove(): void;
  duplicate(): void;
}

const BESIDE_M = 1; // of a copy

export function deeds(placing: Placing): Deeds {
  const wholes = () => placing.chosen.filter(isWhole);
  const take = (how: (things: Thing[]) => void) =>
    placing.afterEdits(() => {
      const gone = wholes();
      placing.choose(null);
      if (gone.length) how(gone);
    });
  const remove = () => take((gone) => takeOut(placing.store.state, gone, placing.change));
  const off = () => take((gone) => switchOff(placing.store, gone, placing.change));
  const duplicate = () => {
    for (const thing of wholes()) copy(placing, thing);
  };
  const button = (text: string, title: string, onclick: () => void) => h("button", { title, onclick }, text);
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
    button("Switch off", "Take it out, and keep it in this list to put it back", off),
    button("Remove", "Take it out (Delete)", remove),
  ];
  return {
    element: h("div", { class: "things-row" }, ...courses, ...whole),
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
          class: "thing off",
          title: "Switch on",
          disabled: !placing.steers,
          onclick: () => placing.afterEdits(() => placing.choose(switchOn(placing.store, each, placing.change))),
        },
        h("span", { class: "name" }, each.name),
        h("span", { class: "muted" }, "switch on"),
      ),
  };
}

/** Whether it can be taken out. */
function isWhole(thing: Thing): boolean {
  return listOf(thing) !== null;
}

/** The list that has it as a whole. */
function listOf({ key, partOf }: Thing): List | null {
  return partOf ? null : (LISTS.find((each) => key.startsWith(each)) ?? null);
}

function copy(placing: Placing, thing: Thing): void {
  const beside = new Matrix4().makeTranslation(0, BESIDE_M, 0).multiply(thing.T);
  const moved = patched(placing.store.state.model!, thing.changes(beside, new Vector3(1, 1, 1)));
  add(placing, listOf(thing)!, valueAt(moved, thing.key) as Table, thing.title);
}
