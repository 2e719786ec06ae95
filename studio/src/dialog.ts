// A dialog of the page: Escape, a click beside it or its button closes it.

import { h, signButton } from "./dom.ts";

export function dialog(title: string, body: HTMLElement): HTMLDialogElement {
  const close = signButton("close", "Close", () => element.close());
  const element = h("dialog", { "aria-label": title }, h("header", {}, h("h2", {}, title), close), body);
  element.addEventListener("click", (event) => {
    if (event.target === element) element.close();
  });
  return element;
}

/** Ask before an action, which a button names and Enter chooses. */
export function confirm(title: string, text: string, action: string, act: () => void): void {
  const go = h("button", { class: "accent", autofocus: true }, action);
  const leave = h("button", {}, "Cancel");
  const element = dialog(title, h("div", { class: "dialog-body" }, h("p", {}, text), h("div", { class: "dialog-actions" }, leave, go)));
  go.addEventListener("click", () => {
    element.close();
    act();
  });
  leave.addEventListener("click", () => element.close());
  element.addEventListener("close", () => element.remove());
  document.body.append(element);
  element.showModal();
}
