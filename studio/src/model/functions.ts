// The lighting functions in short: on or off, their controllers with the gains, and all keys of each.

import { h } from "../dom.ts";
import type { Studio } from "../state.ts";
import { type Content, node, onceOpen, tableOf } from "./branch.ts";
import { switchOff, switchOn } from "./entries.ts";
import { addByName } from "./items.ts";
import type { Off } from "./overrides.ts";
import { part, type Table } from "./overrides.ts";
import type { Editor, Node } from "./row.ts";
import type { Schema } from "./schema.ts";

const KEY = "functions";

export class FunctionList {
  readonly element = h("div", { class: "functions" });
  readonly #cards = new Map<string, { kind: string; card: Node }>();
  readonly #item: Schema;

  constructor(
    private readonly editor: Editor,
    private readonly store: Studio,
  ) {
    const { form } = editor.schemas.field(editor.schemas.root.properties?.[KEY] ?? {});
    this.#item = form.is === "mapping" ? form.item : {};
    this.element.append(addByName(editor, KEY, this.#item, () => Object.keys({ ...this.#functions, ...this.#off }), null));
  }

  get #functions(): Record<string, Table> {
    return (this.store.state.model?.functions ?? {}) as Record<string, Table>;
  }

  /** Functions that are switched off. */
  get #off(): Record<string, Off> {
    return Object.fromEntries(this.store.state.off.filter(({ list }) => list === KEY).map((each) => [each.name, each]));
  }

  show(): void {
    const functions = this.#functions;
    const off = Object.entries(this.#off).map(([name, { table }]) => [name, table] as const);
    const all = new Map([...Object.entries(functions), ...off]);
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

  #switch(name: string, on: boolean): void {
    const edit = (overrides: string[]) => this.editor.edit(...overrides);
    if (on) switchOn(this.store, this.#off[name], edit);
    else switchOff(this.store, [{ key: part(KEY, name), title: name }], edit);
  }

  /** The controller, open, and all other keys, closed. */
  #parts(key: string, kind: string): Content {
    const { form } = this.editor.schemas.field(this.#item);
    const { controller, ...others } = (form.is === "variants" && form.of.get(kind)?.properties) || {};
    const of = controller ? node(this.editor, part(key, "controller"), "controller", controller) : null;
    if (of?.element instanceof HTMLDetailsElement) of.element.open = true;
    const body = h("div", { class: "key-body" });
    const element = h("details", { class: "key-branch" }, h("summary", {}, h("span", { class: "key-name" }, "all its keys")), body);
    const show = onceOpen(element, body, () => tableOf(this.editor, key, others, null));
    return {
      elements: [...(of ? [of.element] : []), element],
      show(value) {
        of?.show((value as Table).controller ?? null);
        show(value);
      },
    };
  }
}
