// Sliders that turn and dim the modules, as lighting functions of the kind `command` do.

import { h } from "../dom.ts";
import type { Module } from "../protocol.ts";
import type { Session } from "../session.ts";
import type { Studio } from "../state.ts";

export const MOVEMENTS = ["swivel_deg", "level_deg", "intensity"] as const;
export type Command = Record<(typeof MOVEMENTS)[number], number>;
const REST: Command = { swivel_deg: 0, level_deg: 0, intensity: 1 };
const WORDS = { swivel_deg: "to the left, deg", level_deg: "down, deg", intensity: "intensity" };
const STEPS = { swivel_deg: 0.1, level_deg: 0.1, intensity: 0.01 };

/** The key of the function that commands a module. */
export function keyOf(module: string): string {
  return `functions.commanded_${module.replaceAll(" ", "_")}`;
}

/** What commands a module; nothing, which takes the function out, where it rests. */
export function override(module: string, command: Command): string {
  const values = MOVEMENTS.filter((each) => command[each] !== REST[each]).map((each) => `,${each}=${command[each]}`);
  return `${keyOf(module)}=${values.length ? `{kind="command",modules=["${module}"]${values.join("")}}` : "{}"}`;
}

export class ModuleSliders {
  readonly #list = h("div", { class: "drive-modules-list" });
  readonly element = h("details", { class: "drive-modules" }, h("summary", { title: "Turn and dim modules" }, "modules"), this.#list);
  #shows: (() => void)[] = [];

  constructor(
    private readonly store: Studio,
    private readonly session: Session,
  ) {
    store.on(["scenario"], ({ scenario }) => this.#make(scenario?.runs[0]?.modules ?? []));
    store.on(["model", "refused"], () => this.#show());
  }

  #make(modules: readonly Module[]): void {
    this.#shows = [];
    this.#list.replaceChildren(
      ...modules.map((module) => {
        const ranges = { swivel_deg: module.swivel_deg, level_deg: module.level_deg, intensity: [0, 1] as const };
        const sliders = MOVEMENTS.filter((each) => ranges[each][0] < ranges[each][1]).map((each) =>
          this.#slider(module.name, each, ranges[each]),
        );
        const rest = h(
          "button",
          { class: "quiet", title: `Let ${module.name} rest`, onclick: () => this.#edit(module.name, REST) },
          "rest",
        );
        return h("fieldset", {}, h("legend", {}, module.name, rest), ...sliders);
      }),
    );
    this.#show();
  }

  #slider(module: string, movement: keyof Command, [min, max]: readonly [number, number]): HTMLElement {
    const name = `${module}, ${WORDS[movement]}`;
    const input = h("input", { type: "range", min, max, step: STEPS[movement], "aria-label": name, title: name });
    const value = h("output");
    input.addEventListener("input", () => this.#edit(module, { ...this.#now(module), [movement]: input.valueAsNumber }));
    this.#shows.push(() => {
      input.value = String(this.#now(module)[movement]);
      value.textContent = input.value;
    });
    return h("label", {}, WORDS[movement], input, value);
  }

  #edit(module: string, command: Command): void {
    this.session.edit([override(module, command)]);
  }

  #now(module: string): Command {
    const functions = this.store.state.model?.functions as Record<string, Partial<Command>> | undefined;
    return { ...REST, ...functions?.[keyOf(module).slice("functions.".length)] };
  }

  #show(): void {
    for (const show of this.#shows) show();
  }
}
