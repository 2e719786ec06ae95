// Sentences that appear and go again, and a list that screen readers are told of.

import { h, ICONS, icon } from "./dom.ts";

const SHOWN_MS = 9000;
const MOST = 4;

export class Toasts {
  readonly element = h("div", { class: "toasts", role: "alert", "aria-live": "assertive" });

  /** good: a thing that was done; else one that is wrong. */
  readonly show = (sentence: string, good = false): void => {
    const same = [...this.element.children].find((each) => each.firstChild?.textContent === sentence);
    same?.remove();
    const close = h("button", { type: "button", class: "quiet", "aria-label": "Close this message" }, icon(ICONS.close));
    const toast = h("div", { class: good ? "toast good" : "toast" }, h("span", {}, sentence), close);
    close.addEventListener("click", () => toast.remove());
    this.element.append(toast);
    while (this.element.children.length > MOST) this.element.firstElementChild?.remove();
    setTimeout(() => toast.remove(), SHOWN_MS);
  };
}
