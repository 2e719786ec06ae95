// Panels with a title, a bar of controls, and a button that lets one fill the page.

import { h, relabel, signButton } from "./dom.ts";
import type { PanelName, Studio } from "./state.ts";

export interface Panel {
  element: HTMLElement;
  bar: HTMLElement;
  body: HTMLElement;
}

export function panel(store: Studio, name: PanelName, title: string): Panel {
  const flip = () => store.set({ maximised: store.state.maximised === name ? null : name });
  const grow = signButton("grow", "", flip);
  const bar = h("div", { class: "bar" });
  const id = `panel-${name}`;
  const head = h("header", { class: "panel-head" }, h("h2", { id }, title), bar, grow);
  head.addEventListener("dblclick", (event) => {
    if (event.target instanceof Element && event.target.closest("button, input, select, label, .popover")) return;
    flip();
  });
  const body = h("div", { class: "panel-body" });
  const element = h("section", { class: `panel ${name}`, "data-panel": name, "aria-labelledby": id }, head, body);
  store.on(["maximised"], ({ maximised }) => {
    element.hidden = maximised !== null && maximised !== name;
    relabel(grow, maximised === name ? "Show all panels (m)" : `Maximise: ${title.toLowerCase()} (m)`);
    grow.setAttribute("aria-pressed", String(maximised === name));
  });
  return { element, bar, body };
}

/** Name of the panel that the keyboard or the mouse is in; the scene without one. */
export function panelInUse(): PanelName {
  const found = document.activeElement?.closest<HTMLElement>("[data-panel]") ?? document.querySelector<HTMLElement>("[data-panel]:hover");
  return (found?.dataset.panel as PanelName | undefined) ?? "scene";
}
