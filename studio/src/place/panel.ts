// The list of things beside the scene, the numbers of what is chosen, and what can be done with it.

import { h, toggle } from "../dom.ts";
import type { Tool } from "../state.ts";
import type { Adding } from "./add.ts";
import type { Deeds } from "./deeds.ts";
import type { Placing } from "./placing.ts";
import type { Figure, Sort, Thing } from "./thing.ts";

const SORTS: readonly (readonly [Sort, string])[] = [
  ["function", "Light"],
  ["object", "Objects"],
  ["light", "Street lamps and probes"],
  ["road", "Road"],
  ["car", "Own car"],
];
export const TOOLS: readonly (readonly [Tool, string, string])[] = [
  ["move", "g", "move"],
  ["turn", "t", "turn"],
  ["scale", "b", "size"],
];

export function placePanel(placing: Placing, adding: Adding, deeds: Deeds, bar: HTMLElement, body: HTMLElement): void {
  const { store } = placing;
  const open = toggle("things", "What can be chosen, moved, added and removed (e)", (things) => store.set({ things }));
  bar.append(open.button);
  const tools = TOOLS.map(([tool, key, name]) => ({ tool, ...toggle(name, `${name} (${key})`, () => store.set({ tool })) }));
  const list = h("div", { class: "things-list", role: "listbox", "aria-label": "Things in the scene", "aria-multiselectable": "true" });
  const numbers = h("div", { class: "things-numbers" });
  const say = h("p", { class: "things-say", role: "status" });
  const element = h(
    "aside",
    { class: "things", "aria-label": "Things" },
    h("div", { class: "things-row" }, h("span", { class: "segments" }, ...tools.map(({ button }) => button)), adding.element),
    say,
    list,
    numbers,
    deeds.element,
  );
  body.append(element);
  let listed = "";
  let figured = "";
  let inputs: [Figure, HTMLInputElement][] = [];

  const showList = () => {
    const { chosen, off } = store.state;
    const key = JSON.stringify([placing.things.map(({ key, title, kind }) => [key, title, kind]), off, placing.steers]);
    if (key !== listed) {
      listed = key;
      list.replaceChildren(
        ...SORTS.flatMap(([sort, title]) =>
          group(
            title,
            placing.things.filter((each) => each.sort === sort && !each.partOf),
          ),
        ),
      );
      if (off.length) list.append(h("h3", {}, "Switched off"), ...off.map((each) => deeds.offRow(each)));
    }
    for (const row of list.querySelectorAll<HTMLElement>("[data-key]")) {
      row.setAttribute("aria-selected", String(chosen.includes(row.dataset.key!)));
    }
  };
  const group = (title: string, things: Thing[]): HTMLElement[] => (things.length ? [h("h3", {}, title), ...things.map(row)] : []);
  const row = ({ key, title, kind }: Thing) =>
    h(
      "button",
      {
        role: "option",
        class: "thing",
        "data-key": key,
        title: key,
        onclick: (event) => placing.choose(key, event.shiftKey),
      },
      h("span", { class: "name" }, title),
      h("span", { class: "muted" }, kind),
    );

  const showNumbers = () => {
    const [thing, ...others] = placing.chosen;
    const key = others.length ? "several" : JSON.stringify([thing?.key, thing?.figures]);
    if (key !== figured) {
      figured = key;
      inputs = others.length || !thing ? [] : thing.figures.map((figure) => [figure, number(figure)]);
      const text = others.length ? `${placing.chosen.length} things move and turn together` : (thing?.title ?? "");
      numbers.replaceChildren(
        h("h3", {}, text),
        ...inputs.map(([figure, input]) => {
          const style = figure.label.length > SHORT ? "long" : null;
          return h("label", { title: figure.key, class: style }, figure.label, input, figure.unit);
        }),
      );
      numbers.hidden = !thing;
    }
    for (const [figure, input] of inputs) {
      if (document.activeElement !== input) input.value = short(placing.valueOf(figure.key));
      input.disabled = !placing.steers;
    }
  };
  const number = (figure: Figure) => {
    const input = h("input", { type: "number", step: figure.unit === "°" ? 1 : 0.1, "aria-label": figure.key });
    input.addEventListener("change", () => {
      if (Number.isFinite(input.valueAsNumber)) placing.edit([[figure.key, input.valueAsNumber]]);
    });
    return input;
  };

  placing.onChange.push(() => {
    const { things, tool } = store.state;
    element.hidden = !things;
    open.show(things);
    for (const each of tools) each.show(each.tool === tool);
    say.textContent = placing.clicking?.say ?? "";
    say.hidden = !placing.clicking;
    placing.view.canvas.style.cursor = placing.clicking ? "crosshair" : "";
    if (!things) return;
    adding.show();
    deeds.show();
    showList();
    showNumbers();
  });
}

const SHORT = 6; // letters of a label beside which another one has room

/** A number with two decimals, or two digits where it is small. */
function short(value: unknown): string {
  if (typeof value !== "number") return "";
  return String(Math.abs(value) < 0.1 ? +value.toPrecision(2) : +value.toFixed(2));
}
