// Items of lists and of tables by name: they are chosen, added, renamed and removed.

import { h, signButton } from "../dom.ts";
import { override, part, unused } from "./overrides.ts";
import type { Editor } from "./row.ts";
import type { Form, Schema } from "./schema.ts";

/** An item with what renames and removes it. value: as it is now. */
export function named(editor: Editor, key: string, name: string, element: HTMLElement, value: () => unknown, free: boolean): HTMLElement {
  const remove = removeButton(part(key, name), () => editor.edit(override(part(key, name), null)));
  if (!free) return h("div", { class: "key-item" }, element, remove);
  const field = h("input", {
    type: "text",
    value: name,
    "aria-label": `Name of ${part(key, name)}`,
    class: "key-rename",
    spellcheck: "false",
  });
  field.addEventListener("change", () => {
    if (field.value && field.value !== name) editor.edit(override(part(key, name), null), override(part(key, field.value), value()));
    field.value = name;
  });
  return h("div", { class: "key-item" }, element, h("label", { title: `Rename ${name}` }, "name ", field), remove);
}

/** A form that adds an item: a name, and a kind where there are several. taken: names that there are. names: all that there can be, if so. */
export function addByName(editor: Editor, key: string, item: Schema, taken: () => string[], names: string[] | null): HTMLElement {
  const { form } = editor.schemas.field(item);
  const kind = form.is === "variants" ? variantChoice(`${key}: new one`, form, false) : null;
  const label = `${key}: name of a new one`;
  const name = names
    ? h("select", { "aria-label": label }, ...names.map((each) => h("option", { value: each }, each)))
    : h("input", { type: "text", "aria-label": label, placeholder: "name", spellcheck: "false", autocomplete: "off" });
  const add = () => {
    const chosen = name.value.trim() || unused(kind?.value ?? "new", taken());
    if (taken().includes(chosen)) {
      name.focus();
      return;
    }
    editor.edit(override(part(key, chosen), editor.schemas.fresh(item, chosen, kind?.value)));
    if (!names) name.value = "";
  };
  const button = h("button", { onclick: add }, "Add");
  return h("div", { class: "key-add" }, name, kind, button);
}

/** A select of the variants of a table. */
export function variantChoice(key: string, { tag, of }: Extract<Form, { is: "variants" }>, optional: boolean): HTMLSelectElement {
  const options = [...of.keys()].map((each) => h("option", { value: each }, each));
  return h("select", { "aria-label": `${key}: ${tag}` }, optional && h("option", { value: "" }, "none"), ...options);
}

export function removeButton(key: string, onclick: () => void): HTMLButtonElement {
  return signButton("close", `Remove ${key}`, onclick);
}
