// Disturbances by a button: glare, lost frames, noise and latency, for a second or until they are switched off.

import { h, toggle } from "../dom.ts";
import type { Model } from "../protocol.ts";
import type { State, Studio } from "../state.ts";
import { newestStep } from "../state.ts";
import { override, part, type Table, valueAt } from "./overrides.ts";

interface Spell {
  from_step: number;
  until_step: number | null;
}

/** A kind of disturbance as edits. */
interface Kind {
  name: string;
  title: string;
  active(model: Model, step: number): boolean;
  /** until: step at which it is over, null for never. */
  begin(state: Readonly<State>, model: Model, step: number, until: number | null): string;
  end(model: Model, step: number): string[];
}

const AHEAD_M = [40, 3, 0.7]; // of an oncoming lamp before the car
const LATENCY = "camera.latency_steps";

const KINDS: Kind[] = [
  spells("glare", "A lamp of 10,000 cd shines into the camera from 40 m", "disturbances.oncoming", (state) => ({
    position_m: before(state, AHEAD_M),
    intensity_cd: 10_000,
  })),
  spells("lost frames", "No frame arrives", "disturbances.drops", () => ({ probability: 1 })),
  spells("noise", "The camera's noise is five times as strong", "disturbances.noise", () => ({ factor: 5 })),
  {
    name: "latency",
    title: "Frames arrive three steps later, until it is switched off",
    active: (model) => Number(valueAt(model, LATENCY)) > 0,
    begin: () => override(LATENCY, 3),
    end: () => [override(LATENCY, 0)],
  },
];

/** Disturbances that are entries of a list. */
function spells(name: string, title: string, key: string, entry: (state: Readonly<State>) => Table): Kind {
  const all = (model: Model) => (valueAt(model, key) ?? []) as Spell[];
  const holds = ({ from_step, until_step }: Spell, step: number) => from_step <= step && (until_step === null || step < until_step);
  return {
    name,
    title,
    active: (model, step) => all(model).some((each) => holds(each, step)),
    begin: (state, model, step, until) => override(key, [...all(model), { from_step: step, until_step: until, ...entry(state) }]),
    end: (model, step) =>
      all(model).flatMap((each, k) =>
        holds(each, step) ? override(part(part(key, k), "until_step"), Math.max(step, each.from_step + 1)) : [],
      ),
  };
}

/** A point before the car, in the world. */
function before({ runs }: Readonly<State>, [x, y, z]: number[]): number[] {
  const T = runs[0]?.shown?.T_world_body;
  if (!T) return [x, y, z];
  return [0, 4, 8].map((row) => +(T[row] * x + T[row + 1] * y + T[row + 2] * z + T[row + 3]).toFixed(3));
}

export function disturbances(store: Studio, edit: (overrides: string[]) => void): HTMLElement {
  const second = h("input", { type: "checkbox", checked: true });
  const buttons = KINDS.map((kind) => ({
    kind,
    ...toggle(kind.name, kind.title, (on) => {
      const { state } = store;
      if (!state.model || !state.scenario) return;
      const step = newestStep(state) + 1;
      const until = second.checked ? step + Math.round(state.scenario.rate_hz) : null;
      edit(on ? [kind.begin(state, state.model, step, until)] : kind.end(state.model, step));
    }),
  }));
  store.on(["model", "rows_version", "step_version"], (state) => {
    for (const { kind, show } of buttons) show(state.model !== null && kind.active(state.model, newestStep(state) + 1));
  });
  return h(
    "div",
    { class: "disturb", role: "group", "aria-label": "Disturb" },
    ...buttons.map(({ button }) => button),
    h("label", { title: "For a second of the run; else until the button is pressed again" }, second, "for 1 s"),
  );
}
