// What lists, variants and tables by name have in common.

import { h, ICONS, icon } from "../dom.ts";
import type { Form } from "./schema.ts";

export type Table = Record<string, unknown>;

/** A select of the variants of a table. */
export function variantChoice(key: string, { tag, of }: Extract<Form, { is: "variants" }>, optional: boolean): HTMLSelectElement {
  const options = [...of.keys()].map((each) => h("option", { value: each }, each));
  return h("select", { "aria-label": `${key}: ${tag}` }, optional && h("option", { value: "" }, "none"), ...options);
}

/** A name that is none of these yet. */
export function unused(name: string, taken: readonly unknown[]): string {
  if (!taken.includes(name)) return name;
  let number = 2;
  while (taken.includes(`${name}_${number}`)) number++;
  return `${name}_${number}`;
}

export function removeButton(key: string, onclick: () => void): HTMLButtonElement {
  return h("button", { type: "button", class: "quiet", title: `Remove ${key}`, "aria-label": `Remove ${key}`, onclick }, icon(ICONS.close));
}
