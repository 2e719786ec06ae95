// Buttons that take edits back and make them again, save the scenario, and record the run.

import { h, ICONS, icon } from "../dom.ts";
import type { ClientMessage } from "../protocol.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio } from "../state.ts";

export interface History {
  elements: HTMLElement[];
  undo(): void;
  redo(): void;
  save(): void;
}

export function history(store: Studio, session: Session): History {
  const send = (message: ClientMessage) => () => {
    if (hasPen(store.state)) session.send(message);
  };
  const [undo, redo, save] = (["undo", "redo", "save"] as const).map((type) => send({ type }));
  const button = (sign: keyof typeof ICONS, title: string, onclick: () => void) =>
    h("button", { type: "button", class: "square", title, "aria-label": title, onclick }, icon(ICONS[sign]));
  const record = h("button", { type: "button", class: "toggle record", "aria-pressed": "false" }, icon(ICONS.record), "Record");
  record.addEventListener("click", () => session.send({ type: "record", folder: store.state.status?.recording ? null : folder(store) }));
  const elements = [
    button("undo", "Undo (Ctrl+Z)", undo),
    button("redo", "Redo (Ctrl+Shift+Z)", redo),
    button("save", "Save the scenario as a file (Ctrl+S)", save),
    record,
  ];
  store.on(["link", "status", "id", "role"], (state) => {
    for (const each of elements) each.disabled = !hasPen(state);
    const recording = state.status?.recording ?? null;
    record.setAttribute("aria-pressed", String(recording !== null));
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
