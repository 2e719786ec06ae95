// The camera's picture with the light on or off, their difference, the extracted symbol, and marks.

import { fill, h, select, toggle } from "../dom.ts";
import type { Measuring, Pixel } from "../measure/index.ts";
import { panel } from "../panels.ts";
import { runSwitch } from "../runs.ts";
import type { Look, Studio } from "../state.ts";
import { type Point, Viewport } from "../viewport.ts";
import { drawMarks, MARKS } from "./marks.ts";
import { difference, differenceTable, digitalNumber, grey, painted } from "./picture.ts";

const FRAMES = [
  ["on", "light on"],
  ["off", "light off"],
  ["signed", "difference, 0 grey"],
  ["clipped", "difference, 0 black"],
] as const;
type Frame = (typeof FRAMES)[number][0];
const SYMBOL_BGR = 0xe9b456; // little-endian blue, green, red

export function cameraPanel(store: Studio, measures: Pick<Measuring, "hover" | "press">): HTMLElement {
  const { element, bar, body } = panel(store, "camera", "Camera");
  let frame: Frame = "on";
  let withMarks = true;
  let withSymbol = false;
  let image: OffscreenCanvas | null = null;
  let symbol: OffscreenCanvas | null = null;
  let stale = true;
  let cursor: Pixel | null = null;
  const tables = { signed: differenceTable(true), clipped: differenceTable(false) };
  const readout = h("output", { class: "readout" });
  const legend = h("div", { class: "legend" });
  const notes = h("ul", { class: "step-notes", "aria-label": "Notes on the step" });
  const empty = h("p", { class: "empty" }, "No picture of the camera yet.");

  const look = (): Look | null => store.state.runs[store.state.camera_run]?.look ?? null;
  const refresh = () => {
    const { on, off, symbol: seen } = look() ?? {};
    const single = frame === "off" ? off : frame === "on" ? on : undefined;
    if (single) image = painted(grey(single));
    else image = on && off && (frame === "signed" || frame === "clipped") ? painted(difference(grey(on), grey(off), tables[frame])) : null;
    symbol = withSymbol && seen ? painted(grey(seen), (code) => (Math.round(0.8 * code) << 24) | SYMBOL_BGR) : null;
    stale = false;
  };
  const view = new Viewport(
    "Picture of the camera",
    {
      draw(context, scale) {
        if (stale) refresh();
        const camera = store.state.scenario?.runs[store.state.camera_run]?.camera;
        if (!camera) return;
        context.fillStyle = "#000";
        context.fillRect(0, 0, camera.width, camera.height);
        if (image) context.drawImage(image, 0, 0, camera.width, camera.height);
        if (symbol) context.drawImage(symbol, 0, 0, camera.width, camera.height);
        const marks = look()?.marks ?? [];
        if (withMarks) drawMarks(context, marks, scale);
        read();
      },
      hover(point) {
        cursor = point && pixelOf(point);
        read();
        measures.hover(cursor);
      },
      press: (point) => measures.press(pixelOf(point)),
    },
    48,
  );
  const read = () => {
    const { on, off } = look() ?? {};
    const bits = store.state.scenario?.runs[store.state.camera_run]?.camera.bits ?? 8;
    readout.textContent = cursor ? number(cursor, frame, bits, on && grey(on), off && grey(off)) : "";
  };
  const changed = () => {
    stale = true;
    const marks = look()?.marks ?? [];
    const kinds = (Object.keys(MARKS) as (keyof typeof MARKS)[]).filter((kind) => withMarks && marks.some((each) => each.kind === kind));
    if (legend.dataset.kinds !== kinds.join()) {
      legend.dataset.kinds = kinds.join();
      legend.replaceChildren(...kinds.map((kind) => h("span", { class: `mark ${kind}` }, MARKS[kind].text)));
    }
    const { on, off } = look() ?? {};
    const needed = frame === "on" ? [on] : frame === "off" ? [off] : [on, off];
    empty.hidden = needed.every(Boolean);
    empty.textContent = on ? "The camera has taken no picture with the light off." : "No picture of the camera yet.";
    view.redraw();
  };
  const choose = () => {
    store.set({ pictures: [...(frame === "on" ? [] : ["off" as const]), ...(withSymbol ? ["symbol" as const] : [])] });
    changed();
  };
  const marksToggle = toggle("marks", "Draw what is tracked, masked, found, lit and aimed at", (now) => {
    withMarks = now;
    marksToggle.show(now);
    changed();
  });
  marksToggle.show(true);
  const symbolToggle = toggle("symbol", "Tint the symbol as it was extracted", (now) => {
    withSymbol = now;
    symbolToggle.show(now);
    choose();
  });
  const frames = select("Frame of the camera", FRAMES, (value) => {
    frame = value as Frame;
    choose();
  });
  bar.append(runSwitch(store, "camera_run"), frames, marksToggle.button, symbolToggle.button);
  body.append(view.canvas, empty, readout, notes, legend);
  store.on(["scenario", "camera_run"], ({ scenario, camera_run }) => {
    const run = scenario?.runs[camera_run];
    if (!run) return;
    view.setContent(run.camera.width, run.camera.height);
    // Without a symbol that a controller holds, there is no frame with the light off.
    const offered = Object.keys(run.controllers).length > 0 ? FRAMES : FRAMES.slice(0, 1);
    fill(frames, offered);
    if (offered.some(([each]) => each === frame)) return;
    frame = "on";
    choose();
  });
  store.on(["camera_version", "camera_run", "runs"], changed);
  store.on(["maximised"], view.redraw);
  store.on(["step_version", "camera_run", "runs"], ({ runs, camera_run }) => {
    const told = runs[camera_run]?.shown?.notes ?? [];
    if (notes.dataset.told === told.join("\n")) return;
    notes.dataset.told = told.join("\n");
    notes.replaceChildren(...told.map((note) => h("li", {}, note)));
  });
  return element;
}

type GreyPicture = ReturnType<typeof grey> | undefined;

function pixelOf({ x, y }: Point): Pixel {
  return { u: Math.floor(x), v: Math.floor(y) };
}

function number({ u, v }: Pixel, frame: Frame, bits: number, on: GreyPicture, off: GreyPicture): string {
  const of = (picture: GreyPicture) =>
    picture && u >= 0 && v >= 0 && u < picture.width && v < picture.height
      ? digitalNumber(picture.codes[v * picture.width + u], bits)
      : null;
  const [a, b] = [of(on), of(off)];
  const value = frame === "on" ? a : frame === "off" ? b : a !== null && b !== null ? a - b : null;
  return value === null ? "" : `u ${u}, v ${v}: ${value} of ${2 ** bits - 1}`;
}
