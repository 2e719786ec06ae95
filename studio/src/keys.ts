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

export function bindKeys(store: Studio, does: { playOrPause: () => void; step: () => void; reset: () => void; help: () => void }): void {
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
    "?": does.help,
    ...Object.fromEntries(VIEWPOINTS.map(([viewpoint], k) => [String(k + 1), () => store.set({ viewpoint })])),
  };
  document.addEventListener("keydown", (event) => {
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const target = event.target instanceof Element ? event.target : document.body;
    if (target.closest("dialog, .popover, input:not([type=range], [type=checkbox]), textarea")) return;
    if (event.key === " " && target.closest("button, input, summary")) return;
    if (/^[\w ]$/.test(event.key) && target.closest("select")) return; // which looks for options that begin so
    event.preventDefault();
    if (!event.repeat || "[].".includes(event.key)) act();
  });
}
