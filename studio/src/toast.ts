// The sentence that appears last, of which screen readers are told.

import { h, ICONS, icon } from "./dom.ts";

const SHOWN_MS = 9000;

export class Toasts {
  readonly element = h("div", { class: "toasts", role: "alert", "aria-live": "assertive" });

  /** good: a thing that was done, which goes again by itself; what is wrong stays until it is closed or another sentence comes. */
  readonly show = (sentence: string, good = false): void => {
    const close = h("button", { type: "button", class: "quiet", "aria-label": "Close this message" }, icon(ICONS.close));
    const toast = h("div", { class: good ? "toast good" : "toast" }, h("span", {}, sentence), close);
    close.addEventListener("click", () => toast.remove());
    this.element.replaceChildren(toast);
    if (good) setTimeout(() => toast.remove(), SHOWN_MS);
  };
}
