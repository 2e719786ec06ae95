// Buttons that take edits back and make them again, save the scenario, and record the run.

import { h, ICONS, icon, signButton } from "../dom.ts";
import type { Session } from "../session.ts";
import { needsPen, type Studio } from "../state.ts";

export interface History {
  elements: HTMLElement[];
  undo(): void;
  redo(): void;
  save(): void;
}

export function history(store: Studio, session: Session): History {
  const [undo, redo, save] = (["undo", "redo", "save"] as const).map((type) => () => session.steer({ type }));
  const record = h("button", { class: "toggle record", "aria-pressed": "false" }, icon(ICONS.record), "Record");
  record.addEventListener("click", () => session.send({ type: "record", folder: store.state.status?.recording ? null : folder(store) }));
  const elements = [
    signButton("undo", "Undo (Ctrl+Z)", undo, "square"),
    signButton("redo", "Redo (Ctrl+Shift+Z)", redo, "square"),
    signButton("save", "Save the scenario as a file (Ctrl+S)", save, "square"),
    record,
  ];
  needsPen(store, ...elements);
  store.on(["status"], ({ status }) => {
    const recording = status?.recording;
    record.setAttribute("aria-pressed", String(Boolean(recording)));
    record.title = recording
      ? `Recording into runs/${recording}; press to end`
      : "Record all steps of the run into a new folder in runs, where luxloop studio was started";
  });
  return { elements, undo, redo, save };
}

/** A folder's name that is new: of the scenario and the time. */
function folder({ state }: Studio): string {
  const time = new Date().toISOString().slice(0, 19).replaceAll(":", "-").replace("T", "_");
  return `${state.scenario?.name ?? "run"}_${time}`.replaceAll(/[^A-Za-z0-9_.-]/g, "_").slice(0, 80);
}
