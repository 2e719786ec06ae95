// The drawer of keys: disturbances, functions, and every key of the scenario, with a search.

import { h, signButton } from "../dom.ts";
import type { Session } from "../session.ts";
import { hasPen, needsPen, type Studio } from "../state.ts";
import { node, tableOf } from "./branch.ts";
import { disturbances } from "./disturb.ts";
import { FunctionList } from "./functions.ts";
import { knownLists } from "./known.ts";
import { type Table, valueAt } from "./overrides.ts";
import { clearRefused, showRefused } from "./refused.ts";
import { actsOf, type Editor, type Node } from "./row.ts";
import { Schemas } from "./schema.ts";
import { MOST, search } from "./search.ts";

export function keysPanel(store: Studio, session: Session, toast: (sentence: string) => void): HTMLElement {
  const close = signButton("close", "Close the keys (k)", () => store.set({ keys_open: false }));
  const words = h("input", {
    type: "search",
    placeholder: "Search names and descriptions",
    "aria-label": "Search keys",
    autocomplete: "off",
  });
  const note = h("p", { class: "muted" });
  const content = h("fieldset", {}, h("p", { class: "muted" }, "Waiting for the keys ..."));
  const head = h("header", {}, h("h2", { id: "keys-title" }, "Keys"), words, close);
  const element = h("aside", { class: "keys-panel", "aria-labelledby": "keys-title" }, head, note, content, ...knownLists(store));
  let made = false;
  let asked = false; // for the schema
  store.on(["keys_open"], ({ keys_open }) => {
    element.hidden = !keys_open;
    if (keys_open) words.focus();
  });
  store.on(["keys_open", "schema", "scenario", "link"], ({ keys_open, schema, model, link }) => {
    if (!keys_open || made) return;
    if (schema && model) {
      made = true;
      content.replaceChildren(...parts(store, session, new Schemas(schema), words));
    } else if (!schema && link === "open" && !asked) session.send({ type: "schema" });
    asked = link === "open" && !schema;
  });
  needsPen(store, content);
  store.on(["link", "status", "id", "role"], (state) => {
    note.hidden = hasPen(state) || state.link !== "open";
    note.textContent = state.role === "watch" ? "You watch: values can be read, but not changed." : "Take the pen to change values.";
  });
  store.on(["scenario"], clearRefused);
  store.on(["refused"], ({ refused }) => {
    if (refused && !showRefused(content, refused)) toast(refused.text);
  });
  return element;
}

function parts(store: Studio, session: Session, schemas: Schemas, words: HTMLInputElement): HTMLElement[] {
  const editor: Editor = {
    schemas,
    edit: (...overrides) => {
      clearRefused();
      session.edit(overrides);
    },
    busy: (key) => session.isEditing(key),
    acts: (key) => actsOf(key, store.state.scenario?.acts ?? {}),
  };
  const functions = new FunctionList(editor, store);
  const all = tableOf(editor, "", schemas.root.properties ?? {}, null);
  const everything = h(
    "div",
    {},
    section(
      "Disturb",
      disturbances(store, (overrides) => editor.edit(...overrides)),
    ),
    section("Functions", functions.element),
    section("All keys", ...all.elements),
  );
  const results = h("div", { class: "keys-found" });
  const count = h("p", { class: "muted", role: "status" });
  let found: { key: string; node: Node }[] = [];
  const look = () => {
    const model = store.state.model as Table;
    const list = words.value.trim() ? search(schemas, model, words.value) : [];
    everything.hidden = words.value.trim() !== "";
    if (list.map(({ key }) => key).join() !== found.map(({ key }) => key).join()) {
      found = list.map(({ key, schema, fallback }) => ({ key, node: node(editor, key, key, schema, fallback) }));
      results.replaceChildren(...found.map((each) => each.node.element));
    }
    for (const each of found) each.node.show(valueAt(model, each.key) ?? null);
    count.hidden = !everything.hidden;
    count.textContent = counted(found.length);
  };
  words.addEventListener("input", look);
  store.on(["model", "refused", "off"], ({ model }) => {
    if (!model) return;
    functions.show();
    all.show(model);
    look();
  });
  return [count, results, everything];
}

function counted(number: number): string {
  if (number === 0) return "No key matches the search.";
  return number === 1 ? "One key matches." : `${number < MOST ? number : `The first ${MOST}`} keys match.`;
}

function section(title: string, ...content: HTMLElement[]): HTMLElement {
  return h("details", { class: "keys-section", open: true }, h("summary", {}, h("h3", {}, title)), ...content);
}
