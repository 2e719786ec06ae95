// Borders between panels that are dragged or moved by arrow keys, panels that change places, and what this browser remembers of the page.

import { h } from "./dom.ts";
import type { State, Studio } from "./state.ts";

/** Where they are at first, in % of the page from its left or upper end: custom properties of the style sheet. */
const BORDERS = {
  columns: { label: "Width of the scene", at: 65, across: true },
  pictures: { label: "Height of the camera", at: 38, across: false },
  rows: { label: "Height of the curves", at: 73, across: false },
  drawer: { label: "Width of the keys", at: 74, across: true },
} as const;
type Border = keyof typeof BORDERS;
const [LEAST, MOST, STEP] = [15, 85, 2];
const REMEMBERED = ["keys_open", "things", "maximised", "viewpoint"] as const satisfies readonly (keyof State)[];
const PLACE = "luxloop";

interface Remembered {
  /** Areas of panels that are in another's place. */
  areas?: Partial<Record<string, string>>;
  borders?: Partial<Record<Border, number>>;
  views?: Partial<Pick<State, (typeof REMEMBERED)[number]>>;
}

/** Borders by name, each as an element between two panels. panels: two change places where the title of one is dragged onto the other. */
export function layout(store: Studio, panels: readonly HTMLElement[]): Record<Border, HTMLElement> {
  const kept = remembered();
  const areas = { ...kept.areas };
  const borders: Partial<Record<Border, number>> = { ...kept.borders };
  store.set({ ...kept.views });
  const keep = () => {
    const views = Object.fromEntries(REMEMBERED.map((key) => [key, store.state[key]]));
    localStorage.setItem(PLACE, JSON.stringify({ areas, borders, views }));
  };
  const border = (name: Border): HTMLElement => {
    const { label, across } = BORDERS[name];
    const element = h("div", {
      class: `border ${name}`,
      role: "separator",
      tabindex: 0,
      title: `${label}: drag, arrow keys, double click for the usual one`,
      "aria-label": label,
      "aria-orientation": across ? "vertical" : "horizontal",
    });
    const place = () => borders[name] ?? BORDERS[name].at;
    const set = (at: number) => {
      borders[name] = Math.min(MOST, Math.max(LEAST, at));
      show();
    };
    const show = () => {
      document.body.style.setProperty(`--${name}`, String(place()));
      element.setAttribute("aria-valuenow", place().toFixed(0));
    };
    show();
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    element.addEventListener("pointermove", (event) => {
      if (!element.hasPointerCapture(event.pointerId)) return;
      const { left, top, width, height } = element.parentElement!.getBoundingClientRect();
      set(across ? (100 * (event.clientX - left)) / width : (100 * (event.clientY - top)) / height);
    });
    element.addEventListener("pointerup", keep);
    element.addEventListener("dblclick", () => {
      delete borders[name];
      show();
      keep();
    });
    element.addEventListener("keydown", (event) => {
      const by = { [across ? "ArrowLeft" : "ArrowUp"]: -STEP, [across ? "ArrowRight" : "ArrowDown"]: STEP }[event.key];
      if (by === undefined) return;
      event.preventDefault();
      set(place() + by);
      keep();
    });
    return element;
  };
  const area = ({ dataset }: HTMLElement) => areas[dataset.panel!] ?? dataset.panel!;
  const arrange = () => {
    for (const each of panels) each.style.setProperty("--area", area(each));
  };
  arrange();
  for (const panel of panels) {
    const title = panel.querySelector("h2")!;
    title.title = "Drag onto another panel: both change places";
    title.addEventListener("pointerdown", ({ pointerId }) => title.setPointerCapture(pointerId));
    title.addEventListener("pointermove", ({ clientX, clientY, pointerId }) => {
      if (!title.hasPointerCapture(pointerId)) return;
      const over = document.elementFromPoint(clientX, clientY)?.closest("[data-panel]");
      for (const each of panels) each.classList.toggle("target", each === over && each !== panel);
    });
    title.addEventListener("lostpointercapture", () => {
      const other = panels.find(({ classList }) => classList.contains("target"));
      if (!other) return;
      other.classList.remove("target");
      [areas[panel.dataset.panel!], areas[other.dataset.panel!]] = [area(other), area(panel)];
      arrange();
      keep();
    });
  }
  store.on(REMEMBERED, keep);
  return { columns: border("columns"), pictures: border("pictures"), rows: border("rows"), drawer: border("drawer") };
}

function remembered(): Remembered {
  try {
    return JSON.parse(localStorage.getItem(PLACE) ?? "{}") as Remembered;
  } catch {
    return {};
  }
}
