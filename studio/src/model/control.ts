// The control of one value, by its form. A change is told once it is one; a slider tells of each.

import { h } from "../dom.ts";
import { listOf } from "./known.ts";
import { span, stepFor, stepOf, unitOf } from "./numbers.ts";
import { toml } from "./overrides.ts";
import type { Field, Range } from "./schema.ts";

export interface Control {
  elements: (HTMLElement | string)[];
  show(value: unknown): void;
}

type Changed = (value: unknown) => void;
/** id: for the first element's label. help: id of what describes it. */
interface Ids {
  id: string;
  help: string;
}

const LONGEST = 300; // characters of a text that is shown

export function control(field: Field, key: string, ids: Ids, changed: Changed): Control {
  const { form } = field;
  switch (form.is) {
    case "number":
      return number(field, form.range, key, ids, changed);
    case "numbers":
      return numbers(form.ranges, key, ids, changed);
    case "boolean":
      return field.optional ? choice(field, [true, false], ids, changed) : check(ids, changed);
    case "choice":
      return choice(field, form.options, ids, changed);
    case "flags":
      return flags(form.options, key, ids, changed);
    case "words":
      return words(field, form.whole, ids, changed);
    default:
      return text(field, key, ids, changed);
  }
}

function number(field: Field, range: Range, key: string, { id, help }: Ids, changed: Changed): Control {
  const input = h("input", { id, type: "number", "aria-describedby": help, placeholder: field.optional ? "left out" : null });
  const slider = h("input", { type: "range", "aria-label": `${key}, slider`, "aria-describedby": help });
  let shown: unknown = null;
  const fit = (value: number) => {
    const [low, high] = [Number(slider.min), Number(slider.max)];
    const ends = !slider.hidden && slider.max && low <= value && value <= high ? null : span(range, key, value, field.default);
    if (ends) Object.assign(slider, { min: String(ends[0]), max: String(ends[1]), step: String(stepOf(ends, range.whole)) });
    slider.hidden = !slider.max && !ends;
    input.step = slider.hidden ? String(stepFor(value, range.whole)) : slider.step;
  };
  slider.removeAttribute("max");
  const show = (value: unknown) => {
    shown = value;
    if (typeof value !== "number") {
      slider.hidden = true;
      input.value = "";
      return;
    }
    fit(value);
    if (input.valueAsNumber !== value) input.value = String(value);
    if (slider.valueAsNumber !== value) slider.value = String(value);
  };
  const told = (value: number) => {
    const rounded = range.whole ? Math.round(value) : +value.toPrecision(12);
    if (rounded !== shown) changed(rounded);
    shown = rounded;
  };
  slider.addEventListener("input", () => {
    input.value = slider.value;
    told(slider.valueAsNumber);
  });
  input.addEventListener("change", () => {
    if (input.value === "" && field.optional && shown !== null) changed((shown = null));
    else if (Number.isNaN(input.valueAsNumber)) show(shown);
    else {
      slider.value = input.value;
      told(input.valueAsNumber);
    }
  });
  return { elements: [slider, input, sign(key)], show };
}

function numbers(ranges: Range[], key: string, { id, help }: Ids, changed: Changed): Control {
  const inputs = ranges.map((_, k) =>
    h("input", {
      id: k === 0 ? id : null,
      type: "number",
      "aria-describedby": help,
      "aria-label": k === 0 ? null : `${key}, number ${k + 1}`,
    }),
  );
  let shown: unknown[] = [];
  const show = (value: unknown) => {
    shown = Array.isArray(value) ? value : [];
    inputs.forEach((input, k) => {
      const each = shown[k];
      if (typeof each === "number") input.step = String(stepFor(each, ranges[k].whole));
      if (input.valueAsNumber !== each) input.value = String(each ?? "");
    });
  };
  const told = () => {
    const values = inputs.map((each) => each.valueAsNumber);
    if (!values.some(Number.isNaN)) changed(values);
    else if (shown.length > 0) show(shown);
  };
  for (const input of inputs) input.addEventListener("change", told);
  return { elements: [...inputs, sign(key)], show };
}

function sign(key: string): HTMLElement | string {
  const { unit } = unitOf(key);
  return unit && h("span", { class: "unit" }, unit);
}

function check({ id, help }: Ids, changed: Changed): Control {
  const input = h("input", { id, type: "checkbox", "aria-describedby": help, onchange: () => changed(input.checked) });
  return { elements: [input], show: (value) => (input.checked = value === true) };
}

function choice(field: Field, options: readonly (string | number | boolean)[], { id, help }: Ids, changed: Changed): Control {
  const texts = options.map((each) => (each === true ? "yes" : each === false ? "no" : String(each)));
  const element = h("select", { id, "aria-describedby": help });
  element.append(
    ...(field.optional ? [h("option", { value: "" }, "left out")] : []),
    ...texts.map((each, k) => h("option", { value: k }, each)),
  );
  element.addEventListener("change", () => changed(element.value === "" ? null : options[Number(element.value)]));
  return {
    elements: [element],
    show(value) {
      const found = options.indexOf(value as string);
      element.value = found < 0 ? "" : String(found);
    },
  };
}

function flags(options: readonly (string | number)[], key: string, { id, help }: Ids, changed: Changed): Control {
  const inputs = options.map((_, k) => h("input", { id: k === 0 ? id : null, type: "checkbox" }));
  const told = () => changed(options.filter((_, k) => inputs[k].checked));
  for (const input of inputs) input.addEventListener("change", told);
  const labels = options.map((each, k) => h("label", {}, inputs[k], String(each)));
  return {
    elements: [h("div", { class: "key-flags", role: "group", "aria-label": key, "aria-describedby": help }, ...labels)],
    show: (value) => inputs.forEach((input, k) => (input.checked = Array.isArray(value) && value.includes(options[k]))),
  };
}

/** Words or whole numbers, with commas between. */
function words(field: Field, whole: boolean, { id, help }: Ids, changed: Changed): Control {
  const hint = field.optional ? "left out" : "none; with commas between";
  const input = h("input", { id, type: "text", "aria-describedby": help, placeholder: hint, spellcheck: "false", autocomplete: "off" });
  input.addEventListener("change", () => {
    const given = input.value.split(",").flatMap((each) => each.trim() || []);
    if (given.length === 0 && field.optional) changed(null);
    else changed(whole ? given.map((each) => (/^\d+$/.test(each) ? Number(each) : each)) : given);
  });
  return { elements: [input], show: (value) => (input.value = Array.isArray(value) ? value.join(", ") : "") };
}

/** A text; or a value whose form is open, to read alone. */
function text(field: Field, key: string, { id, help }: Ids, changed: Changed): Control {
  const plain = field.form.is === "text";
  const input = h("input", { id, type: "text", list: listOf(key), "aria-describedby": help, spellcheck: "false", autocomplete: "off" });
  if (field.optional) input.placeholder = "left out";
  input.addEventListener("change", () => changed(input.value === "" && field.optional ? null : input.value));
  return {
    elements: [input],
    show(value) {
      const whole = value === null || value === undefined ? "" : plain ? String(value) : toml(value);
      input.readOnly = !plain || whole.length > LONGEST;
      input.value = whole.length > LONGEST ? `${whole.length} characters` : whole;
    },
  };
}
