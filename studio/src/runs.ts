// Which of two runs a panel shows.

import { h } from "./dom.ts";
import type { Studio } from "./state.ts";

export function runSwitch(store: Studio, key: "camera_run" | "matrix_run"): HTMLElement {
  const element = h("div", { class: "segments", role: "group", "aria-label": "Run" });
  store.on(["scenario", key], ({ scenario, [key]: shown }) => {
    const runs = scenario?.runs ?? [];
    element.hidden = runs.length < 2;
    element.replaceChildren(
      ...runs.map(({ label }, run) =>
        h(
          "button",
          {
            class: "toggle",
            title: `Run ${run + 1}: ${label}`,
            "aria-label": `Run ${run + 1}: ${label}`,
            "aria-pressed": String(run === shown),
            onclick: () => store.set({ [key]: run }),
          },
          `${run + 1}`,
        ),
      ),
    );
  });
  return element;
}
