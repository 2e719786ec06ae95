// A button that opens a list with a filter: arrow keys move, Enter chooses, Escape closes.

import { h, relabel } from "./dom.ts";
import type { Named } from "./protocol.ts";

export interface Chooser {
  element: HTMLElement;
  /** Items to choose from, and the text on the button. */
  show(items: readonly Named[], text: string): void;
  disabled: boolean;
}

let chooserCount = 0;

export function chooser(label: string, onchoose: (name: string) => void): Chooser {
  const id = `chooser-${++chooserCount}`;
  const text = h("span", { class: "chooser-text" });
  const button = h("button", { class: "chooser-button", "aria-haspopup": "listbox", "aria-expanded": "false" }, text);
  const filter = h("input", {
    type: "search",
    placeholder: "Filter",
    "aria-label": `${label}: filter`,
    role: "combobox",
    "aria-controls": id,
    "aria-expanded": "true",
    autocomplete: "off",
    spellcheck: "false",
  });
  const list = h("ul", { id, role: "listbox", "aria-label": label });
  const popover = h("div", { class: "popover" }, filter, list);
  popover.hidden = true;
  const element = h("div", { class: "chooser" }, button, popover);
  let items: readonly Named[] = [];
  let current = 0;

  const options = () => [...list.querySelectorAll<HTMLElement>("[role=option]")];
  const mark = (number: number) => {
    const all = options();
    current = Math.max(0, Math.min(number, all.length - 1));
    all.forEach((each, k) => each.setAttribute("aria-selected", String(k === current)));
    all[current]?.scrollIntoView({ block: "nearest" });
    if (all[current]) filter.setAttribute("aria-activedescendant", all[current].id);
    else filter.removeAttribute("aria-activedescendant");
  };
  const close = (focus: boolean) => {
    if (popover.hidden) return;
    popover.hidden = true;
    button.setAttribute("aria-expanded", "false");
    if (focus) button.focus();
  };
  const choose = (name: string | undefined) => {
    if (name === undefined) return;
    filter.blur(); // so that keys are the page's again
    close(false);
    onchoose(name);
  };
  const draw = () => {
    const found = matching(items, filter.value);
    list.replaceChildren(
      ...found.map(({ name, description }, k) =>
        h(
          "li",
          { role: "option", id: `${id}-${k}`, "data-name": name, onclick: () => choose(name), onmousemove: () => current !== k && mark(k) },
          h("strong", {}, name),
          h("span", {}, description),
        ),
      ),
    );
    if (found.length === 0) list.append(h("li", { class: "none" }, "Nothing matches the filter."));
    mark(0);
  };
  const open = () => {
    popover.hidden = false;
    button.setAttribute("aria-expanded", "true");
    filter.value = "";
    draw();
    filter.focus();
  };
  button.addEventListener("click", () => (popover.hidden ? open() : close(true)));
  filter.addEventListener("input", draw);
  filter.addEventListener("keydown", (event) => {
    const steps: Record<string, number> = { ArrowDown: 1, ArrowUp: -1, PageDown: 8, PageUp: -8 };
    if (event.key in steps) mark(current + steps[event.key]);
    else if (event.key === "Enter") choose(options()[current]?.dataset.name);
    else return;
    event.preventDefault();
  });
  element.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || popover.hidden) return;
    event.stopPropagation();
    close(true);
  });
  element.addEventListener("focusout", (event) => {
    if (!(event.relatedTarget instanceof Node && element.contains(event.relatedTarget))) close(false);
  });
  popover.addEventListener("mousedown", (event) => {
    if (event.target !== filter) event.preventDefault();
  });

  return {
    element,
    show(newItems, newText) {
      items = newItems;
      text.textContent = newText;
      relabel(button, `${label}: ${newText}`);
      if (!popover.hidden) draw();
    },
    get disabled() {
      return button.disabled;
    },
    set disabled(disabled) {
      button.disabled = disabled;
      if (disabled) close(false);
    },
  };
}

/** Items with all words of a filter in name or description, first those that have them in the name. */
export function matching(items: readonly Named[], filter: string): Named[] {
  const words = filter.toLowerCase().split(/\s+/).filter(Boolean);
  const has = (text: string) => words.every((word) => text.toLowerCase().includes(word));
  const found = items.filter(({ name, description }) => has(`${name} ${description}`));
  return found.sort((one, other) => Number(has(other.name)) - Number(has(one.name)));
}
