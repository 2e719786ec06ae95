// What keys do with what is chosen.

import type { Deeds } from "./deeds.ts";
import { TOOLS } from "./panel.ts";
import type { Placing } from "./placing.ts";

export const PLACE_KEYS: [string, string][] = [
  ["e", "list what can be chosen and moved in the scene"],
  ["Click, Shift+click", "in the scene: choose, choose more; drag what is chosen over the road"],
  ["g, t, b", "handles that move, turn or change the size of what is chosen"],
  ["Ctrl while dragging", "no steps of 0.1 m and 5°"],
  ["Delete, Shift+D", "remove or duplicate what is chosen"],
  ["Enter, Esc", "end a way of points; leave what is begun, or choose nothing"],
];

export function bindPlaceKeys(placing: Placing, deeds: Deeds): void {
  const { store } = placing;
  const chosen = (act: () => void) => () => {
    if (!store.state.chosen.length) return false;
    act();
    return true;
  };
  const steering = (act: () => void) => chosen(() => placing.steers && act());
  const keys: Record<string, () => boolean> = {
    e: () => {
      store.set({ things: !store.state.things });
      return true;
    },
    ...Object.fromEntries(TOOLS.map(([tool, key]) => [key, chosen(() => store.set({ tool }))])),
    Delete: steering(deeds.remove),
    Backspace: steering(deeds.remove),
    "shift d": steering(deeds.duplicate),
    Enter: () => {
      const done = placing.clicking?.done;
      done?.();
      return done !== undefined;
    },
    Escape: () => {
      if (!placing.clicking) return chosen(() => placing.choose(null))();
      placing.await(null);
      return true;
    },
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || event.repeat) return;
    const target = event.target instanceof Element ? event.target : document.body;
    if (target.closest("dialog, .popover, input:not([type=range], [type=checkbox]), textarea, select")) return;
    if (event.key === "Enter" && target.closest("button, summary")) return;
    const key = event.shiftKey && event.key.length === 1 ? `shift ${event.key.toLowerCase()}` : event.key;
    if (keys[key]?.()) event.preventDefault();
  });
}
