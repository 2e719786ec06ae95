// The direction indicator, on which lighting functions with the key `indicated` act.

import { h } from "../dom.ts";
import type { Session } from "../session.ts";
import type { Studio } from "../state.ts";

export type Indicator = "off" | "left" | "right" | "hazard";
type Switch = Exclude<Indicator, "off">;
const SWITCHES: readonly [Switch, string, string][] = [
  ["left", "◀", "Indicate left (q)"],
  ["hazard", "△", "Hazard lights (x)"],
  ["right", "▶", "Indicate right (e)"],
];
const KEYS: Readonly<Record<string, Switch>> = { KeyQ: "left", KeyE: "right", KeyX: "hazard" };

/** What a key or button makes of the indicator: the same one again switches it off. */
export function pressed(now: Indicator, by: Switch): Indicator {
  return now === by ? "off" : by;
}

/** Whether the button of a switch blinks. */
export function blinks(now: Indicator, button: Switch): boolean {
  return now === button || (now === "hazard" && button !== "hazard");
}

export class IndicatorSwitch {
  readonly element = h("span", { class: "segments", role: "group", "aria-label": "Indicator" });

  /** What was asked for last, until it is answered. */
  #asked: Indicator = "off";

  constructor(
    private readonly store: Studio,
    private readonly session: Session,
  ) {
    for (const [each, sign, title] of SWITCHES)
      this.element.append(h("button", { class: "toggle", title, "aria-label": title, onclick: () => this.press(each) }, sign));
    store.on(["model"], () => this.#refresh());
  }

  /** The action of a key by `KeyboardEvent.code`, if it has one. */
  ofKey(code: string): (() => void) | undefined {
    const by = KEYS[code];
    return by && (() => this.press(by));
  }

  press(by: Switch): void {
    this.#asked = pressed(this.#now(), by);
    this.session.edit([`lighting.indicator="${this.#asked}"`]);
  }

  #now(): Indicator {
    if (this.session.isEditing("lighting.indicator")) return this.#asked;
    const lighting = this.store.state.model?.lighting as { indicator: Indicator } | undefined;
    return lighting?.indicator ?? "off";
  }

  #refresh(): void {
    SWITCHES.forEach(([each], k) => {
      const button = this.element.children[k];
      button.setAttribute("aria-pressed", String(this.#now() === each));
      button.classList.toggle("blinks", blinks(this.#now(), each));
    });
  }
}
