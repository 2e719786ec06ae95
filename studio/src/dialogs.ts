// Dialogs: the keys, and the summary of the runs.

import { dialog } from "./dialog.ts";
import { h } from "./dom.ts";
import { DRIVE_KEYS } from "./drive/index.ts";
import { flat } from "./flat.ts";
import { PLACE_KEYS } from "./place/keys.ts";
import type { Session } from "./session.ts";
import type { Studio } from "./state.ts";

export interface Dialog {
  element: HTMLDialogElement;
  open(): void;
}

const KEYS: [string, string][] = [
  ["Space", "play or pause"],
  [".", "one step"],
  ["r", "start anew"],
  ["k", "open the drawer with all keys of the scenario"],
  ["Ctrl+Z, Ctrl+Shift+Z", "undo the last edit, redo it"],
  ["Ctrl+S", "save the scenario as it is now, as a file"],
  ["[ and ]", "darker or lighter view of the scene, by 1/2 EV"],
  ["1 to 5", "viewpoint: orbit, above, driver, oncoming, wall"],
  ["m", "maximise the panel below the cursor, or show all panels"],
  ["Left and Right", "on the slider: a step back or on"],
  ["Wheel, dragging", "zoom and move the camera's picture and the matrix; with the keyboard + - and arrow keys"],
  ["Double click", "on a picture: show all of it; on a panel's title: maximise it"],
  ["Click on a curve", "look at that step again"],
  ["Enter in keys", "set other values of keys; Shift+Enter compares with them"],
  ...PLACE_KEYS,
  ...DRIVE_KEYS,
  ["?", "this list"],
  ["Esc", "close a list or dialog"],
];

export function helpDialog(): Dialog {
  const rows = KEYS.map(([key, text]) => h("tr", {}, h("th", { scope: "row" }, h("kbd", {}, key)), h("td", {}, text)));
  const element = dialog("Keyboard shortcuts", h("div", { class: "dialog-body" }, h("table", {}, h("tbody", {}, ...rows))));
  return { element, open: () => element.open || element.showModal() };
}

export function summaryDialog(store: Studio, session: Session): Dialog {
  const body = h("div", { class: "dialog-body", tabindex: 0, role: "region", "aria-label": "Summary" });
  const element = dialog("Summary of the run so far", body);
  const draw = () => {
    const { scenario, runs } = store.state;
    const found = runs.map(({ summary }) => new Map(flat(summary)));
    const names = [...new Set(found.flatMap((each) => [...each.keys()]))];
    if (names.length === 0) {
      body.replaceChildren(h("p", {}, "Waiting for the server ..."));
      return;
    }
    const labels =
      found.length > 1 ? (scenario?.runs ?? []).map(({ label }) => h("th", { scope: "col" }, label)) : [h("th", { scope: "col" }, "value")];
    const rows = names.map((name) =>
      h("tr", {}, h("th", { scope: "row" }, name), ...found.map((each) => h("td", {}, each.get(name) ?? ""))),
    );
    body.replaceChildren(
      h("table", {}, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "of the run"), ...labels)), h("tbody", {}, ...rows)),
    );
  };
  store.on(["summary_version", "runs"], () => element.open && draw());
  return {
    element,
    open() {
      if (element.open) return;
      for (const [run, data] of store.state.runs.entries()) {
        data.summary = null;
        session.send({ type: "summary", run });
      }
      draw();
      element.showModal();
    },
  };
}
