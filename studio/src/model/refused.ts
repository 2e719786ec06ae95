// Why an edit was refused, beside the controls that caused it.

import { h } from "../dom.ts";
import { isWithin, keyOf } from "../edits.ts";

export function clearRefused(): void {
  for (const each of document.querySelectorAll(".key-error")) each.remove();
}

/** Say beside the controls of an edit why it was refused: those that the sentence names, or all. Returns whether one of them is in view. */
export function showRefused(content: HTMLElement, { overrides, text }: { overrides: string[]; text: string }): boolean {
  clearRefused();
  const all = overrides.map((each) => ({ key: keyOf(each), sentence: told(text, keyOf(each)) }));
  const named = all.filter(({ sentence }) => sentence !== null);
  const errors = (named.length > 0 ? named : all).flatMap(({ key, sentence }) =>
    closest(content, key).map((each) => {
      const error = h("p", { class: "key-error", role: "alert" }, sentence ?? text);
      each.append(error);
      return error;
    }),
  );
  return errors.some((each) => each.checkVisibility());
}

/** What a sentence says of a key, or of a table around it, without the names of files and other keys before; null where it names neither. */
export function told(text: string, key: string): string | null {
  for (let end = key.length; end > 0; end = key.lastIndexOf(".", end - 1)) {
    const start = text.indexOf(`${key.slice(0, end)}: `);
    if (start >= 0) return text.slice(start);
  }
  return null;
}

/** The controls of a key, or of the nearest table around it that has some. */
function closest(content: HTMLElement, key: string): HTMLElement[] {
  const all = [...content.querySelectorAll<HTMLElement>("[data-key]")];
  const longest = Math.max(...all.map(({ dataset }) => (isWithin(key, dataset.key!) ? dataset.key!.length : -1)));
  return all.filter(({ dataset }) => isWithin(key, dataset.key!) && dataset.key!.length === longest);
}
