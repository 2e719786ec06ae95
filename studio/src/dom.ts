// Elements in one expression.

type Child = Node | string | null | undefined | false;
type Handlers = { [K in keyof HTMLElementEventMap as `on${K}`]?: (event: HTMLElementEventMap[K]) => void };
type Attributes = Handlers & { [name: string]: unknown };

/** An element. `onclick` and the like are listeners, `true` an empty attribute; false, null and undefined leave an attribute out. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value as EventListener);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
  element.append(...children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false));
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** A drawn sign of 16 x 16 units, so that it looks the same whatever fonts there are. */
export function icon(path: string): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  for (const [name, value] of Object.entries({ viewBox: "0 0 16 16", width: "16", height: "16", "aria-hidden": "true", class: "icon" })) {
    svg.setAttribute(name, value);
  }
  const shape = document.createElementNS(SVG, "path");
  shape.setAttribute("d", path);
  svg.append(shape);
  return svg;
}

export const ICONS = {
  play: "M4 2.5v11l9-5.5z",
  pause: "M4 2.5h3v11H4zM9 2.5h3v11H9z",
  step: "M3 2.5v11l7-5.5zM11 2.5h2.4v11H11z",
  reset:
    "M8 2.2a5.8 5.8 0 1 0 5.8 5.8h-1.9A3.9 3.9 0 1 1 8 4.1c1 0 1.9.4 2.600 1L8.600 7.100h5.200V1.900L11.950 3.750A5.800 5.800 0 0 0 8 2.200z",
  grow: "M2 2h5v1.800H3.800V7H2zM9 2h5v5h-1.800V3.800H9zM2 9h1.800v3.200H7V14H2zM12.200 9H14v5H9v-1.800h3.200z",
  undo: "M6.500 2.500v2.700H9a4 4 0 0 1 0 8H5v-1.700h4a2.300 2.300 0 0 0 0-4.600H6.500v2.700L2 6.050z",
  redo: "M9.500 2.500v2.700H7a4 4 0 0 0 0 8h4v-1.700H7a2.300 2.300 0 0 1 0-4.600h2.500v2.700L14 6.050z",
  save: "M7.100 2h1.800v6h2.600L8 11.500 4.500 8h2.600zM2.500 11h1.700v1.300h7.600V11h1.700v3h-11z",
  record: "M8 4a4 4 0 1 0 0 8 4 4 0 0 0 0-8z",
  close:
    "M3.400 2.200 8 6.800l4.600-4.600 1.200 1.200L9.200 8l4.600 4.600-1.200 1.200L8 9.200l-4.600 4.600-1.200-1.200L6.800 8 2.200 3.400z",
} as const;

/** A button with a sign. label: what it does. */
export function signButton(sign: keyof typeof ICONS, label: string, onclick?: () => void, style = "quiet"): HTMLButtonElement {
  const button = h("button", { class: style, onclick }, icon(ICONS[sign]));
  relabel(button, label);
  return button;
}

/** Tell by a tooltip, and to screen readers, what an element does. */
export function relabel(element: HTMLElement, label: string): void {
  element.title = label;
  element.setAttribute("aria-label", label);
}

/** Let the browser save a file. */
export function download(name: string, content: Blob): void {
  const href = URL.createObjectURL(content);
  h("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 1000);
}

/** Numbers with seven digits, none for NaN. */
export function csv(names: readonly string[], lines: readonly (string | number)[][]): Blob {
  const cell = (each: string | number) => (typeof each === "string" ? each : Number.isNaN(each) ? "" : Number(each.toPrecision(7)));
  return new Blob([[names, ...lines.map((line) => line.map(cell)), ""].join("\n")], { type: "text/csv" });
}

/** A function that calls another once a frame, however often it is called. */
export function onceAFrame(draw: () => void): () => void {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  };
}

/** A toggle button with `aria-pressed`. */
export function toggle(
  text: string,
  title: string,
  onchange: (on: boolean) => void,
): { button: HTMLButtonElement; show: (on: boolean) => void } {
  const button = h("button", { class: "toggle", title, "aria-pressed": "false" }, text);
  button.addEventListener("click", () => onchange(button.getAttribute("aria-pressed") !== "true"));
  return { button, show: (on) => button.setAttribute("aria-pressed", String(on)) };
}

/** A field for a number. */
export function numberField(label: string, attributes: Attributes): HTMLInputElement {
  return h("input", { type: "number", "aria-label": label, title: label, ...attributes });
}

/** Its number, as near as its limits allow. */
export function numberOf({ min, max, valueAsNumber }: HTMLInputElement, otherwise = 0): number {
  return Math.min(Number(max), Math.max(Number(min), Number.isNaN(valueAsNumber) ? otherwise : valueAsNumber));
}

/** A native select with options `[value, text]`. After a choice keys are the page's again, unless arrow keys go through the options. */
export function select(
  label: string,
  options: readonly (readonly [string, string])[],
  onchange: (value: string) => void,
): HTMLSelectElement {
  const element = h("select", { "aria-label": label, title: label });
  let goes = false;
  element.addEventListener("keydown", ({ key }) => (goes = key.startsWith("Arrow")));
  element.addEventListener("pointerdown", () => (goes = false));
  element.addEventListener("change", () => {
    if (!goes) element.blur();
    onchange(element.value);
  });
  fill(element, options);
  return element;
}

/** Other options; the value stays where it is still there. */
export function fill(element: HTMLSelectElement, options: readonly (readonly [string, string])[]): void {
  const value = element.value;
  element.replaceChildren(...options.map(([key, text]) => h("option", { value: key }, text)));
  if (options.some(([key]) => key === value)) element.value = value;
}
