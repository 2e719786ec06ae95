// Sliders that turn and dim the modules, as lighting functions of the kind `command` do.

import { h } from "../dom.ts";
import { override } from "../model/overrides.ts";
import type { Module } from "../protocol.ts";
import type { Session } from "../session.ts";
import type { Studio } from "../state.ts";

const MOVEMENTS = ["swivel_deg", "level_deg", "intensity"] as const;
export type Command = Record<(typeof MOVEMENTS)[number], number>;
export const REST: Command = { swivel_deg: 0, level_deg: 0, intensity: 1 };
const WORDS = { swivel_deg: "to the left, deg", level_deg: "down, deg", intensity: "intensity" };
const DIGITS = { swivel_deg: 1, level_deg: 1, intensity: 2 };

/** The name of the function that commands a module. */
export function nameOf(module: string): string {
  return `commanded_${module.toLowerCase().replace(/[^a-z0-9]+/g, "_")}`;
}

/** What commands a module; what takes the function out where it rests, null where there is none to take out. */
export function commanding(module: string, command: Command, there: boolean): string | null {
  const values = Object.fromEntries(MOVEMENTS.filter((each) => command[each] !== REST[each]).map((each) => [each, command[each]]));
  const rests = Object.keys(values).length === 0;
  if (rests && !there) return null;
  return override(`functions.${nameOf(module)}`, rests ? null : { kind: "command", modules: [module], ...values });
}

export class ModuleSliders {
  readonly #list = h("div", { class: "drive-modules-list" });
  readonly element = h("details", { class: "drive-modules" }, h("summary", { title: "Turn and dim modules" }, "modules"), this.#list);
  #shows: (() => void)[] = [];
  #made = "";
  /** What was asked for last, of each module, until it is answered. */
  readonly #asked = new Map<string, Command>();

  constructor(
    private readonly store: Studio,
    private readonly session: Session,
  ) {
    store.on(["scenario"], ({ scenario }) => this.#make(scenario?.runs[0]?.modules ?? []));
    store.on(["model", "refused"], () => this.#show());
  }

  #make(modules: readonly Module[]): void {
    const given = JSON.stringify(modules.map(({ name, swivel_deg, level_deg }) => [name, swivel_deg, level_deg]));
    if (given === this.#made) return; // also while a slider is held, whose first edit brings columns
    this.#made = given;
    this.#shows = [];
    this.#list.replaceChildren(
      ...modules.map((module) => {
        const ranges = { swivel_deg: module.swivel_deg, level_deg: module.level_deg, intensity: [0, 1] as const };
        const moves = MOVEMENTS.filter((each) => ranges[each][0] < ranges[each][1]);
        const sliders = moves.map((each) => this.#slider(module.name, each, ranges[each]));
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
    const input = h("input", { type: "range", min, max, step: "any", "aria-label": name, title: name });
    const value = h("output");
    input.addEventListener("input", () =>
      this.#edit(module, { ...this.#now(module), [movement]: +input.valueAsNumber.toFixed(DIGITS[movement]) }),
    );
    this.#shows.push(() => {
      input.value = String(this.#now(module)[movement]);
      value.textContent = String(this.#now(module)[movement]);
    });
    return h("label", {}, WORDS[movement], input, value);
  }

  #edit(module: string, command: Command): void {
    const waits = this.session.isEditing(`functions.${nameOf(module)}`);
    if (waits && JSON.stringify(command) === JSON.stringify(this.#asked.get(module))) return;
    const asked = commanding(module, command, waits || this.#told(module) !== undefined);
    if (!asked) return;
    this.#asked.set(module, command);
    this.session.edit([asked]);
    this.#show();
  }

  #told(module: string): Partial<Command> | undefined {
    return (this.store.state.model?.functions as Record<string, Partial<Command>> | undefined)?.[nameOf(module)];
  }

  #now(module: string): Command {
    const asked = this.#asked.get(module);
    if (asked && this.session.isEditing(`functions.${nameOf(module)}`)) return asked;
    return { ...REST, ...this.#told(module) };
  }

  #show(): void {
    for (const show of this.#shows) show();
  }
}
