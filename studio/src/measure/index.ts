// Measuring where the cursor is, in the scene of each run and in the camera's picture, and keeping probes there.

import { Vector3 } from "three";
import type { Vector } from "../arrays.ts";
import { download, h, toggle } from "../dom.ts";
import { putIn } from "../model/entries.ts";
import type { Reading } from "../protocol.ts";
import { degrees, matrix, reference } from "../scene/frames.ts";
import type { ScenesPanel } from "../scenes/panel.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio } from "../state.ts";
import { Meter, type Sight } from "./meter.ts";
import { probeAt, showProbes } from "./probes.ts";
import { csvOf, Profile } from "./profile.ts";
import { readout } from "./readout.ts";

/** A pixel of the camera's picture. */
export interface Pixel {
  u: number;
  v: number;
}

/** CSS pixels of a canvas. */
type Corner = [x: number, y: number];
const WALL_CSV_DEG = { side: 24, bottom: -8, top: 6, step: 0.5 };

export interface Measuring {
  element: HTMLElement;
  profile: HTMLElement;
  /** The cursor is on a pixel of the camera's picture, null: it is outside. */
  hover(pixel: Pixel | null): void;
  /** A pixel is pressed; returns whether something is measured there. */
  press(pixel: Pixel): boolean;
}

export function measuring(store: Studio, session: Session, scenes: ScenesPanel, toast: (sentence: string) => void): Measuring {
  const meter = new Meter(store, session);
  const { element, look } = readout(store, meter);
  showProbes(store, scenes);
  const title = "Keep a probe where you click on road, object, wall or camera picture: a curve, and a column of the recording";
  const probe = toggle("probe", title, (on) => store.set({ aim: on ? "probe" : null }));
  const line = toggle("line", "Drag a line over road or wall: the light along it", (on) => store.set({ aim: on ? "line" : null }));
  const wall = h("button", { title: "Download the light on the wall as CSV, every half degree", onclick: () => saveWall() }, "wall CSV");
  element.append(h("span", { class: "segments", role: "group", "aria-label": "Measure" }, probe.button, line.button, wall));
  store.on(["aim", "viewpoint"], ({ aim, viewpoint }) => {
    probe.show(aim === "probe");
    line.show(aim === "line");
    wall.hidden = viewpoint !== "wall";
  });
  const profile = new Profile(store, meter);

  /** Through a pixel of a scene's canvas, in CSS pixels. */
  const inScene = (run: number, x: number, y: number): Sight | null => {
    const { viewpoint, rule, side } = store.state;
    const view = scenes.views[run];
    if (!view) return null;
    const isWall = viewpoint === "wall";
    const { eye, through } = view.sight(x, y);
    return { run, on: isWall ? "wall" : "scene", eye_m: eye, through_m: [through], side: isWall && rule ? side : null };
  };
  const keep = (sight: Sight | null) => {
    if (!sight) return;
    if (!hasPen(store.state)) toast("Another page holds the pen: take it first to keep a probe.");
    else
      meter.ask(
        "probe",
        () => sight,
        ([reading], refused) => (reading ? put(reading, sight.run) : toast(refused ?? "There is nothing here.")),
      );
  };
  const put = (reading: Reading, run: number) => {
    const [view, shown] = [scenes.views[run], store.state.runs[run]?.shown];
    if (!view || !shown) return;
    if (reading.surface === "wall" && reading.ground_m[2] < 0) {
      toast("This place of the wall lies below the road, where a probe is in the dark: click higher.");
      return;
    }
    putIn(store.state, { list: "probes", name: "probe", table: probeAt(reading, view, shown.T_world_body), checks: {} }, (overrides) =>
      session.edit(overrides),
    );
  };

  /** Light at the angles of the wall's grid, from the chosen lamp or the middle of both. */
  const saveWall = () => {
    const { runs, scenario, rule, side } = store.state;
    const [shown, facts] = [runs[0]?.shown, scenario?.runs[0]];
    if (!shown || !facts) return;
    const T_world_body = matrix(shown.T_world_body);
    const lamp = reference(facts, rule ? side : null).applyMatrix4(T_world_body);
    const towards = (h_deg: number, v_deg: number): Vector => {
      const [h, v] = [degrees(h_deg), degrees(v_deg)];
      const ray = new Vector3(Math.cos(v) * Math.cos(h), -Math.cos(v) * Math.sin(h), Math.sin(v));
      return ray.transformDirection(T_world_body).add(lamp).toArray();
    };
    const { side: most, bottom, top, step } = WALL_CSV_DEG;
    const through_m = stepped(bottom, top, step).flatMap((v) => stepped(-most, most, step).map((h) => towards(h, v)));
    const sight: Sight = { run: 0, on: "wall", eye_m: lamp.toArray(), through_m, side: rule ? side : null };
    meter.ask(
      "wall",
      () => sight,
      (readings, refused) => {
        if (refused) toast(refused);
        else download("wall.csv", csvOf(readings.filter((each) => each !== null)));
      },
    );
  };

  /** A line from one pixel of a scene to another. */
  const draw = (run: number, from: Corner, to: Corner) => {
    const { viewpoint, rule, side } = store.state;
    const [view, shown] = [scenes.views[run], store.state.runs[run]?.shown];
    const [a, b] = [view?.pick(...from), view?.pick(...to)];
    if (!view || !shown || !a || !b) return;
    const isWall = viewpoint === "wall";
    const T = matrix(isWall ? shown.T_world_body : shown.T_world_ground).invert();
    const there = (point: Vector) => new Vector3(...point).applyMatrix4(T);
    const eye = there(view.sight((from[0] + to[0]) / 2, (from[1] + to[1]) / 2).eye);
    profile.show({ view, run, on: isWall ? "wall" : "scene", side: isWall && rule ? side : null, eye, ends: [there(a), there(b)] });
  };

  let begun: { run: number; at: Corner } | null = null;
  const runOf = (target: EventTarget | null) => scenes.views.findIndex(({ canvas }) => canvas === target);
  scenes.body.addEventListener("pointermove", ({ target, offsetX, offsetY }) => {
    const run = runOf(target);
    look(run < 0 ? null : () => inScene(run, offsetX, offsetY));
  });
  scenes.body.addEventListener("pointerleave", () => look(null));
  // Before the canvas, whose orbit camera listens for the same events.
  scenes.body.addEventListener(
    "pointerdown",
    (event) => {
      const run = runOf(event.target);
      const { aim } = store.state;
      if ((aim !== "probe" && aim !== "line") || run < 0 || event.button !== 0) return;
      event.stopImmediatePropagation();
      if (aim === "probe") keep(inScene(run, event.offsetX, event.offsetY));
      else begun = { run, at: [event.offsetX, event.offsetY] };
    },
    { capture: true },
  );
  scenes.body.addEventListener(
    "pointermove",
    ({ target, offsetX, offsetY }) => {
      if (begun && runOf(target) === begun.run) draw(begun.run, begun.at, [offsetX, offsetY]);
    },
    { capture: true },
  );
  document.addEventListener("pointerup", () => (begun = null));
  document.addEventListener("keydown", ({ key }) => key === "Escape" && store.set({ aim: null }));
  return {
    element,
    profile: profile.element,
    hover: (pixel) => look(pixel && (() => throughCamera(store, pixel))),
    press(pixel) {
      if (store.state.aim !== "probe") return false;
      keep(throughCamera(store, pixel));
      return true;
    },
  };
}

/** Multiples of a step from one angle to the other. */
function stepped(from: number, to: number, step: number): number[] {
  return Array.from({ length: Math.round((to - from) / step) + 1 }, (_, k) => from + k * step);
}

/** Through the centre of a pixel of the camera's picture. */
function throughCamera(store: Studio, { u, v }: Pixel): Sight | null {
  const { scenario, camera_run: run, runs } = store.state;
  const [camera, shown] = [scenario?.runs[run]?.camera, runs[run]?.shown];
  if (!camera || !shown || u < 0 || v < 0 || u >= camera.width || v >= camera.height) return null;
  const T = matrix(shown.T_world_camera);
  const through = new Vector3((u + 0.5 - camera.cx) / camera.fx, (v + 0.5 - camera.cy) / camera.fy, 1).applyMatrix4(T);
  const eye = new Vector3().setFromMatrixPosition(T);
  return { run, on: "scene", eye_m: eye.toArray(), through_m: [through.toArray()], side: null };
}
