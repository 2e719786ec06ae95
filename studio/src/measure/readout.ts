// The line below all panels: place, angle and light under the cursor, whatever view it is in.

import { brief } from "../brief.ts";
import { h } from "../dom.ts";
import type { Reading } from "../protocol.ts";
import type { Studio } from "../state.ts";
import type { Meter, Sight } from "./meter.ts";

export interface Readout {
  element: HTMLElement;
  /** Where the cursor is looking now; null nowhere. Asked again with each step. */
  look(sight: (() => Sight | null) | null): void;
}

const HINT = "Light under the cursor: move it over the scene or the camera's picture.";

export function readout(store: Studio, meter: Meter): Readout {
  const element = h("footer", { class: "figures" }, h("output", { "aria-live": "off" }));
  const [output] = element.children;
  let looking: (() => Sight | null) | null = null;
  const ask = () => {
    const asked = looking;
    if (!asked) return;
    meter.ask("cursor", asked, ([reading = null], refused) => {
      if (looking !== null) output.replaceChildren(...(refused ? [refused] : reading ? figures(reading) : ["nothing there"]));
    });
  };
  const look = (sight: (() => Sight | null) | null) => {
    looking = sight;
    if (sight) ask();
    else output.replaceChildren(h("span", { class: "muted" }, HINT));
  };
  store.on(["step_version", "scenario", "viewpoint"], ask);
  look(null);
  return { element, look };
}

/** The figures of a reading, each with what it is as a tooltip. */
function figures({ surface, ground_m: [x, y, z], h_deg, v_deg, distance_m, lx, vertical_lx, cd_m2, cd }: Reading): HTMLElement[] {
  const isWall = surface === "wall";
  const figure = (name: string, value: string, unit: string, title: string) =>
    h("span", { title, "data-figure": name }, h("span", { class: "muted" }, `${name} `), value, unit && ` ${unit}`);
  return [
    h("strong", {}, surface),
    figure("x", fixed(x), "m", "ahead, along the ground"),
    figure("y", fixed(y), "m", "to the left"),
    figure("z", fixed(z), "m", "above the ground"),
    figure("H", signed(h_deg), "°", "angle from the lamp, to the right"),
    figure("V", signed(v_deg), "°", "angle from the lamp, up"),
    figure("d", fixed(distance_m), "m", "distance from the lamp"),
    figure("E", brief(lx), "lx", isWall ? "illuminance of the wall by the lamps" : "illuminance of the surface by the lamps"),
    ...(isWall ? [] : [figure("Ev", brief(vertical_lx), "lx", "illuminance by the lamps of an upright plane there that faces the car")]),
    ...(cd_m2 === null ? [] : [figure("L", brief(cd_m2), "cd/m²", "luminance by all light, as seen from here")]),
    figure("I", brief(cd), "cd", "luminous intensity of the lamp in this direction, far away"),
  ];
}

function fixed(value: number): string {
  return value
    .toFixed(2)
    .replace(/^-(?=0\.00)/, "")
    .replace("-", "−");
}

function signed(angle: number): string {
  return `${angle >= 0.005 ? "+" : ""}${fixed(angle)}`;
}
