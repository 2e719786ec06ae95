// The list of columns from which curves are chosen.

import { h } from "../dom.ts";
import type { Column } from "../protocol.ts";

export interface ColumnList {
  element: HTMLElement;
  /** The columns that there are, and the chosen ones. */
  show(columns: readonly Column[], chosen: ReadonlySet<string>): void;
}

/** onchange: names of the chosen columns, null for the usual ones. */
export function columnList(onchange: (chosen: Set<string> | null) => void): ColumnList {
  const button = h("button", { "aria-expanded": "false", "aria-haspopup": "dialog" }, "Columns");
  const filter = h("input", {
    type: "search",
    placeholder: "Filter by name, unit, description",
    "aria-label": "Filter columns",
    spellcheck: "false",
  });
  const list = h("div", { class: "columns-list", role: "group", "aria-label": "Columns" });
  const usual = h("button", { onclick: () => onchange(null) }, "Usual ones");
  const none = h("button", { onclick: () => onchange(new Set()) }, "None");
  const popover = h(
    "div",
    { class: "popover up columns", role: "dialog", "aria-label": "Columns to draw" },
    h("div", { class: "row" }, filter, usual, none),
    list,
  );
  popover.hidden = true;
  const element = h("div", { class: "chooser" }, button, popover);
  let columns: readonly Column[] = [];
  let chosen: ReadonlySet<string> = new Set();

  const open = (now: boolean) => {
    popover.hidden = !now;
    button.setAttribute("aria-expanded", String(now));
    if (now) {
      draw();
      filter.focus();
    }
  };
  const draw = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const found = columns.filter((each) =>
      words.every((word) => `${each.name} ${each.unit} ${each.description}`.toLowerCase().includes(word)),
    );
    list.replaceChildren(
      ...found.map(({ name, unit, description }) => {
        const box = h("input", { type: "checkbox", "data-name": name });
        box.checked = chosen.has(name);
        box.addEventListener("change", () => {
          const next = new Set(chosen);
          if (box.checked) next.add(name);
          else next.delete(name);
          chosen = next;
          onchange(next);
        });
        return h("label", { title: description }, box, h("span", {}, name), h("span", { class: "muted" }, unit));
      }),
    );
    if (found.length === 0) list.append(h("p", { class: "muted" }, "Nothing matches the filter."));
  };
  filter.addEventListener("input", draw);
  button.addEventListener("click", () => open(popover.hidden === true));
  element.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || popover.hidden) return;
    event.stopPropagation();
    open(false);
    button.focus();
  });
  document.addEventListener("pointerdown", (event) => {
    if (!popover.hidden && event.target instanceof Node && !element.contains(event.target)) open(false);
  });

  return {
    element,
    show(newColumns, newChosen) {
      const same = newColumns === columns && [...newChosen].join() === [...chosen].join();
      columns = newColumns;
      chosen = newChosen;
      if (!popover.hidden && !same) draw();
    },
  };
}
