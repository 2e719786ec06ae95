// The sentence that appears last, of which screen readers are told.

import { h, signButton } from "./dom.ts";

const SHOWN_MS = 9000;

export class Toasts {
  readonly element = h("div", { class: "toasts", role: "alert", "aria-live": "assertive" });

  /** Another scenario is shown: what was wrong with the last one is past. */
  readonly clear = (): void => {
    for (const each of this.element.querySelectorAll(".toast:not(.good)")) each.remove();
  };

  /** good: a thing that was done, which goes again by itself; what is wrong stays until it is closed or another sentence comes. */
  readonly show = (sentence: string, good = false): void => {
    const close = signButton("close", "Close this message", () => toast.remove());
    const toast = h("div", { class: good ? "toast good" : "toast" }, h("span", {}, sentence), close);
    this.element.replaceChildren(toast);
    if (good) setTimeout(() => toast.remove(), SHOWN_MS);
  };
}
