// What the controls of all keys have in common: how they edit, when a key acts, and the way back to its default; and a key with one control.

import { h, signButton } from "../dom.ts";
import type { ScenarioMessage } from "../protocol.ts";
import { control } from "./control.ts";
import { override } from "./overrides.ts";
import { type Field, type Schemas, same } from "./schema.ts";

type Acts = ScenarioMessage["acts"][string];

export interface Editor {
  readonly schemas: Schemas;
  /** Change keys; overrides are `key=value`. */
  edit(...overrides: string[]): void;
  /** Whether an edit of this key is on its way, so that the model is older than the control. */
  busy(key: string): boolean;
  /** When a key acts; null where the server does not say. */
  acts(key: string): Acts | null;
}

/** The controls of a key. */
export interface Node {
  readonly element: HTMLElement;
  /** Show the model's value; null where the key is left out. */
  show(value: unknown): void;
}

/** When a key acts, by the longest beginning of it. */
export function actsOf(key: string, acts: Readonly<Record<string, Acts>>): Acts | null {
  const plain = key.replaceAll(/\[\d+\]/g, "");
  for (let end = plain.length; end > 0; end = plain.lastIndexOf(".", end - 1)) {
    const found = acts[plain.slice(0, end)];
    if (found) return found;
  }
  return acts[""] ?? null;
}

const ACTS = {
  step: ["next step", "Acts at the next step"],
  prepared: ["prepared", "Is prepared while the run waits, which then goes on"],
  restart: ["restarts", "Starts the run anew"],
} as const;

let count = 0;

/** name: as it is shown. */
export function row(editor: Editor, key: string, name: string, field: Field): Node {
  const id = `key-${++count}`;
  const changed = (value: unknown) => editor.edit(override(key, value));
  const inner = control(field, key, { id, help: `${id}-help` }, changed);
  const back = defaultButton(editor, key, field);
  const element = h(
    "div",
    { class: "key-row", "data-key": key },
    h(
      "div",
      { class: "key-head" },
      h("label", { for: id, class: "key-name", title: key }, ...breakable(name)),
      badge(editor, key),
      back.button,
    ),
    h("div", { class: "key-control" }, ...inner.elements),
    h("p", { class: "key-help", id: `${id}-help` }, field.description),
  );
  return {
    element,
    show(value) {
      if (editor.busy(key)) return;
      inner.show(value);
      back.show(value);
      element.classList.toggle("changed", !back.button.hidden);
    },
  };
}

/** A name that may go on in the next line after each dot. */
function breakable(name: string): (string | HTMLElement)[] {
  return name.split(/(?<=\.)/).flatMap((each, k) => (k > 0 ? [h("wbr"), each] : [each]));
}

/** A sign that says when a key acts. */
export function badge(editor: Editor, key: string): HTMLElement | null {
  const acts = editor.acts(key);
  return acts && h("span", { class: `badge ${acts}`, title: ACTS[acts][1] }, ACTS[acts][0]);
}

/** A button that sets the default again, where a value is another. */
export function defaultButton(editor: Editor, key: string, field: Field): { button: HTMLButtonElement; show: (value: unknown) => void } {
  const text = field.default === null ? "left out" : String(JSON.stringify(field.default));
  const title = `Set ${key} to its default again: ${text.length > 60 ? `${text.slice(0, 60)} ...` : text}`;
  const whole = field.form.is === "table" || field.form.is === "variants"; // which an empty table sets to their defaults
  const again = () => editor.edit(override(key, whole ? null : field.default));
  const button = signButton("reset", title, again);
  return { button, show: (value) => (button.hidden = field.default === undefined || same(value ?? null, field.default)) };
}
