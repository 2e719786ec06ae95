// The lighting functions in short: on or off, their controllers with the gains, and all keys of each.

import { h } from "../dom.ts";
import type { Model } from "../protocol.ts";
import { type Content, node, tableOf } from "./branch.ts";
import type { Editor, Node } from "./editor.ts";
import { addByName } from "./named.ts";
import { override, part } from "./overrides.ts";
import type { Table } from "./pieces.ts";
import type { Schema } from "./schema.ts";

const KEY = "functions";

export class FunctionList {
  readonly element = h("div", { class: "functions" });
  readonly #cards = new Map<string, { kind: string; card: Node }>();
  /** Functions that were switched off, as they were, with the checks on them, so that they can be switched on again. */
  readonly #off = new Map<string, { value: Table; checks: Table }>();
  readonly #item: Schema;
  #shown: Table = {};
  #checks: Table = {};

  constructor(private readonly editor: Editor) {
    const { form } = editor.schemas.field(editor.schemas.root.properties?.[KEY] ?? {});
    this.#item = form.is === "mapping" ? form.item : {};
    const adding = addByName(editor, KEY, this.#item, () => [...Object.keys(this.#shown), ...this.#off.keys()], null);
    this.element.append(adding);
  }

  /** Forget what was switched off: the scenario is another. */
  forget(): void {
    this.#off.clear();
  }

  show(model: Model): void {
    const functions = (this.#shown = (model.functions ?? {}) as Table);
    this.#checks = (model.checks ?? {}) as Table;
    for (const name of Object.keys(functions)) this.#off.delete(name);
    const off = [...this.#off].map(([name, { value }]) => [name, value] as const);
    const all = new Map([...Object.entries(functions), ...off] as [string, Table][]);
    for (const [name, { card, kind }] of [...this.#cards]) {
      if (all.get(name)?.kind === kind) continue;
      card.element.remove();
      this.#cards.delete(name);
    }
    for (const [name, value] of all) {
      const kind = String(value.kind);
      const card = this.#cards.get(name)?.card ?? this.#card(name, kind);
      this.#cards.set(name, { kind, card });
      this.element.lastElementChild?.before(card.element);
      card.show(name in functions ? value : null);
    }
  }

  #card(name: string, kind: string): Node {
    const key = part(KEY, name);
    const on = h("input", { type: "checkbox", "aria-label": `${key}: on or off` });
    on.addEventListener("change", () => this.#switch(name, on.checked));
    const parts = this.#parts(key, kind);
    const body = h("div", {}, ...parts.elements);
    const head = h(
      "label",
      { class: "function-name" },
      on,
      h("strong", {}, name),
      h("span", { class: "muted" }, kind.replaceAll("_", " ")),
    );
    return {
      element: h("section", { class: "function", "aria-label": `Function ${name}`, "data-key": key }, head, body),
      show(value) {
        on.checked = value !== null;
        body.hidden = value === null;
        if (value !== null) parts.show(value);
      },
    };
  }

  /** Take a function out with the checks on it, which would have nothing to look at, or put all of them in again. */
  #switch(name: string, on: boolean): void {
    if (!on) this.#off.set(name, { value: this.#shown[name] as Table, checks: checksOn(name, this.#checks) });
    const { value, checks } = this.#off.get(name)!;
    const edits = Object.entries(checks).map(([check, each]) => override(part("checks", check), on ? each : null));
    this.editor.edit(override(part(KEY, name), on ? value : null), ...edits);
  }

  /** The controller, open, and all other keys, closed. */
  #parts(key: string, kind: string): Content {
    const { form } = this.editor.schemas.field(this.#item);
    const { controller, ...others } = (form.is === "variants" && form.of.get(kind)?.properties) || {};
    const of = controller ? node(this.editor, part(key, "controller"), "controller", controller) : null;
    if (of?.element instanceof HTMLDetailsElement) of.element.open = true;
    const element = h("details", { class: "key-branch" }, h("summary", {}, h("span", { class: "key-name" }, "all its keys")));
    let rest: Content | null = null;
    let shown: unknown = null;
    element.addEventListener("toggle", () => {
      if (!element.open || rest) return;
      rest = tableOf(this.editor, key, others, null);
      element.append(h("div", { class: "key-body" }, ...rest.elements));
      rest.show(shown);
    });
    return {
      elements: [...(of ? [of.element] : []), element],
      show(value) {
        shown = value;
        of?.show((value as Table).controller ?? null);
        rest?.show(value);
      },
    };
  }
}

function checksOn(name: string, checks: Table): Table {
  return Object.fromEntries(Object.entries(checks).filter(([, each]) => String((each as Table).metric).startsWith(`${KEY}.${name}.`)));
}
