// Keys that hold others: tables and their variants, lists, and tables by name. What is inside is made when it is first opened.

import { h } from "../dom.ts";
import { addByName, named, removeButton, variantChoice } from "./items.ts";
import { override, part, type Table, unused } from "./overrides.ts";
import { badge, defaultButton, type Editor, type Node, row } from "./row.ts";
import { type Field, type Form, keysOf, type Schema, sameVariant } from "./schema.ts";

const FEW = 4;

type Of<Is extends Form["is"]> = Extract<Form, { is: Is }>;

/** Controls of a key and of all that is in it. name: as it is shown; fallback: its default in that of its table. */
export function node(editor: Editor, key: string, name: string, schema: Schema, fallback?: unknown): Node {
  const field = editor.schemas.field(schema, fallback);
  const { form } = field;
  switch (form.is) {
    case "table":
      return field.optional
        ? optionalTable(editor, key, name, field, schema)
        : branch(editor, key, name, field, () => tableOf(editor, key, form.keys, field.default));
    case "variants":
      return variants(editor, key, name, field, form, schema);
    case "list":
      return list(editor, key, name, field, form);
    case "mapping":
      return branch(editor, key, name, field, () => mapping(editor, key, form));
    default:
      return row(editor, key, name, field);
  }
}

/** What is inside a branch. */
export interface Content {
  elements: HTMLElement[];
  show(value: unknown): void;
}

/** A part that opens. inside: makes what is in it, when it is opened. beside: controls in its head. */
function branch(editor: Editor, key: string, name: string, field: Field, inside: () => Content, ...beside: HTMLElement[]): Node {
  const back = defaultButton(editor, key, field);
  const count = h("span", { class: "muted" });
  const head = h(
    "summary",
    { title: key, "aria-label": key },
    h("span", { class: "key-name" }, name),
    count,
    badge(editor, key),
    ...beside,
    back.button,
  );
  const body = h("div", { class: "key-body" }, field.description ? h("p", { class: "key-help" }, field.description) : null);
  const element = h("details", { class: "key-branch", "data-key": key, open: isSmall(field.form) }, head, body);
  const show = onceOpen(element, body, inside);
  return {
    element,
    show(value) {
      back.show(value);
      element.classList.toggle("changed", !back.button.hidden);
      count.textContent = titleOf(value, field.form);
      show(value);
    },
  };
}

/** Makes what is inside of a part once it is opened. Returns what shows a value in it. */
export function onceOpen(element: HTMLDetailsElement, body: HTMLElement, inside: () => Content): Content["show"] {
  let content: Content | null = null;
  let shown: unknown;
  element.addEventListener("toggle", () => {
    if (!element.open || content) return;
    content = inside();
    body.append(...content.elements);
    content.show(shown);
  });
  return (value) => {
    shown = value;
    content?.show(value);
  };
}

/** Whether it is open at first: a table of few numbers, such as gains. */
function isSmall(form: Form): boolean {
  const keys = form.is === "table" ? Object.values(form.keys) : [];
  return keys.length > 0 && keys.length <= FEW && keys.every(({ type, anyOf }) => (type ?? anyOf?.[0].type) === "number");
}

/** How many parts a value has, or its own name. */
function titleOf(value: unknown, form: Form): string {
  if (form.is === "list" || form.is === "mapping") return `(${Object.keys(value ?? {}).length})`;
  const name = (value as Table | null)?.name;
  return typeof name === "string" && !(form.is === "variants" && form.tag === "name") ? name : "";
}

/** The keys of a table, one after the other. except: one that has its control elsewhere. */
export function tableOf(editor: Editor, key: string, keys: Record<string, Schema>, fallback: unknown, except = ""): Content {
  const nodes = keysOf(keys, fallback)
    .filter(([name]) => name !== except)
    .map(([name, each, usual]) => [name, node(editor, part(key, name), name, each, usual)] as const);
  return {
    elements: nodes.map(([, each]) => each.element),
    show: (value) => nodes.forEach(([name, each]) => each.show((value as Table | null)?.[name] ?? null)),
  };
}

/** Content that is made anew whenever its form changes. */
function changing(formOf: (value: unknown) => string, make: (value: unknown) => Content): Content {
  const element = h("div", { class: "key-parts" });
  let form: string | null = null;
  let content: Content = { elements: [], show: () => {} };
  return {
    elements: [element],
    show(value) {
      if (formOf(value) !== form) {
        form = formOf(value);
        content = make(value);
        element.replaceChildren(...content.elements);
      }
      content.show(value);
    },
  };
}

const NOTHING: Content = { elements: [], show: () => {} };

function optionalTable(editor: Editor, key: string, name: string, field: Field, schema: Schema): Node {
  const { keys } = field.form as Of<"table">;
  const there = h("input", { type: "checkbox", "aria-label": `${key}: there or left out` });
  there.addEventListener("change", () => editor.edit(override(key, there.checked ? editor.schemas.fresh(schema) : null)));
  const inside = () =>
    changing(
      (value) => String(value !== null),
      (value) => (value === null ? NOTHING : tableOf(editor, key, keys, null)),
    );
  const made = branch(editor, key, name, field, inside, there);
  return {
    element: made.element,
    show(value) {
      there.checked = value !== null;
      made.show(value);
    },
  };
}

function variants(editor: Editor, key: string, name: string, field: Field, form: Of<"variants">, schema: Schema): Node {
  const choice = variantChoice(key, form, field.optional);
  choice.addEventListener("change", () => {
    editor.edit(override(key, choice.value === "" ? null : editor.schemas.fresh(schema, name, choice.value)));
  });
  const tagOf = (value: unknown) => String((value as Table | null)?.[form.tag] ?? "");
  const inside = () =>
    changing(tagOf, (value) => {
      const variant = form.of.get(tagOf(value));
      return variant ? tableOf(editor, key, variant.properties ?? {}, sameVariant(field.default, value, form.tag), form.tag) : NOTHING;
    });
  const made = branch(editor, key, name, field, inside, choice);
  return {
    element: made.element,
    show(value) {
      const tag = tagOf(value);
      if (tag && !form.of.has(tag) && ![...choice.options].some((each) => each.value === tag))
        choice.append(h("option", { value: tag }, tag));
      if (!editor.busy(key)) choice.value = tag;
      made.show(value);
    },
  };
}

function list(editor: Editor, key: string, name: string, field: Field, { item }: Of<"list">): Node {
  let shown: unknown[] = [];
  const inner = editor.schemas.field(item).form;
  const choice = inner.is === "variants" ? variantChoice(`${key}: new item`, inner, false) : null;
  const names = () => shown.map((each) => (each as Table | null)?.name);
  const add = h("button", {}, "Add");
  add.addEventListener("click", () => {
    const fresh = editor.schemas.fresh(item, unused(choice?.value ?? "new", names()), choice?.value);
    editor.edit(override(key, [...shown, fresh]));
  });
  const remove = (number: number) =>
    editor.edit(
      override(
        key,
        shown.filter((_, k) => k !== number),
      ),
    );
  const adding = h("div", { class: "key-add" }, choice, add);
  const inside = () => {
    const items = changing(
      (value) => String((value as unknown[]).length),
      (value) => {
        const nodes = (value as unknown[]).map((_, k) => node(editor, part(key, k), `${k}`, item));
        const rows = nodes.map((each, k) =>
          h(
            "div",
            { class: "key-item" },
            each.element,
            removeButton(part(key, k), () => remove(k)),
          ),
        );
        return { elements: rows, show: (values) => nodes.forEach((each, k) => each.show((values as unknown[])[k])) };
      },
    );
    return { elements: [...items.elements, adding], show: items.show };
  };
  const made = branch(editor, key, name, field, inside);
  return {
    element: made.element,
    show(value) {
      shown = Array.isArray(value) ? value : [];
      made.show(shown);
    },
  };
}

function mapping(editor: Editor, key: string, { item, names }: Of<"mapping">): Content {
  const items = changing(
    (value) => Object.keys(value as Table).join(),
    (value) => {
      const nodes = Object.keys(value as Table).map((name) => [name, node(editor, part(key, name), name, item)] as const);
      const rows = nodes.map(([name, each]) => named(editor, key, name, each.element, () => (shown as Table)[name], names === null));
      return { elements: rows, show: (values) => nodes.forEach(([name, each]) => each.show((values as Table)[name])) };
    },
  );
  let shown: unknown = {};
  const adding = addByName(editor, key, item, () => Object.keys(shown as Table), names);
  return {
    elements: [...items.elements, adding],
    show(value) {
      shown = value ?? {};
      items.show(shown);
    },
  };
}
