// What keys do, outside of fields that take text.

import { panelInUse } from "./panels.ts";
import type { Studio, Viewpoint } from "./state.ts";

export const VIEWPOINTS: readonly (readonly [Viewpoint, string])[] = [
  ["orbit", "orbit"],
  ["above", "from above"],
  ["driver", "driver"],
  ["oncoming", "oncoming"],
  ["wall", "wall at 25 m"],
];
export const EXPOSURE_EV = { least: -8, most: 12, step: 0.5 };

type Does = Record<"playOrPause" | "step" | "reset" | "help" | "keys" | "undo" | "redo" | "save", () => void>;

export function bindKeys(store: Studio, does: Does): void {
  const expose = (by: number) => {
    const exposure_ev = Math.min(EXPOSURE_EV.most, Math.max(EXPOSURE_EV.least, store.state.exposure_ev + by));
    store.set({ exposure_ev });
  };
  const keys: Record<string, () => void> = {
    " ": does.playOrPause,
    ".": does.step,
    r: does.reset,
    "[": () => expose(-EXPOSURE_EV.step),
    "]": () => expose(EXPOSURE_EV.step),
    m: () => store.set({ maximised: store.state.maximised ? null : panelInUse() }),
    k: does.keys,
    "?": does.help,
    ...Object.fromEntries(VIEWPOINTS.map(([viewpoint], k) => [String(k + 1), () => store.set({ viewpoint })])),
  };
  const chords: Record<string, () => void> = { z: does.undo, "shift z": does.redo, y: does.redo, s: does.save };
  document.addEventListener("keydown", (event) => {
    const chord = event.ctrlKey || event.metaKey;
    const act = chord ? chords[`${event.shiftKey ? "shift " : ""}${event.key.toLowerCase()}`] : keys[event.key];
    if (!act || event.altKey || event.defaultPrevented) return;
    const target = event.target instanceof Element ? event.target : document.body;
    const writes = target.closest("input:not([type=range], [type=checkbox]), textarea"); // where Ctrl+Z is of the text
    if (target.closest("dialog, .popover") || (writes && !(chord && event.key === "s"))) return;
    if (chord) {
      event.preventDefault();
      act();
      return;
    }
    if (event.key === " " && target.closest("button, input, summary")) return;
    if (/^\w$/.test(event.key) && target.closest("select")) return; // which looks for options that begin so
    event.preventDefault();
    if (!event.repeat || "[].".includes(event.key)) act();
  });
  // A button that was clicked gives the focus back, so that space plays; one that was reached by Tab keeps it.
  document.addEventListener("click", ({ detail, target }) => {
    if (detail > 0 && target instanceof Element && !target.closest("dialog, .popover")) target.closest("button")?.blur();
  });
}
