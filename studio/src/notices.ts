// The line below the toolbar: the connection, what is being prepared, and what has failed.

import { h, signButton } from "./dom.ts";
import type { State, Studio } from "./state.ts";

export function notices(store: Studio): HTMLElement {
  const text = h("span", {});
  let closed: string | null = null;
  const close = signButton("close", "Close this message", () => {
    closed = text.textContent;
    element.hidden = true;
  });
  const element = h("div", { class: "notice", role: "status" }, text, close);
  store.on(["link", "progress", "status", "scenario"], (state) => {
    const found = notice(state);
    if (found?.text !== closed) closed = null;
    element.hidden = found === null || found.text === closed;
    close.hidden = found?.text !== state.status?.failed;
    element.dataset.kind = found?.kind ?? "";
    text.textContent = found?.text ?? "";
  });
  return element;
}

function notice({ link, progress, status, scenario }: Readonly<State>): { kind: "busy" | "bad"; text: string } | null {
  if (link === "refused") {
    return {
      kind: "bad",
      text: "The server does not know this address's token: open the address that luxloop studio printed last, with all that comes after #.",
    };
  }
  if (link === "waiting") return { kind: "bad", text: "The connection to luxloop studio is cut; connecting again ..." };
  if (link === "connecting") return { kind: "busy", text: scenario ? "Connecting again ..." : "Connecting ..." };
  if (progress) return { kind: "busy", text: `${progress[0].toUpperCase()}${progress.slice(1)} ...` };
  if (status?.failed) return { kind: "bad", text: status.failed };
  return scenario ? null : { kind: "busy", text: "Waiting for the first scenario ..." };
}
