// Measuring where the cursor is, in the scene of each run and in the camera's picture, and keeping probes there.

import { Vector3 } from "three";
import { h, toggle } from "../dom.ts";
import { putIn } from "../model/entries.ts";
import type { Reading } from "../protocol.ts";
import { matrix } from "../scene/frames.ts";
import type { ScenesPanel } from "../scenes/panel.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio } from "../state.ts";
import { Meter, type Sight } from "./meter.ts";
import { probeAt, showProbes } from "./probes.ts";
import { readout } from "./readout.ts";

/** A pixel of the camera's picture. */
export interface Pixel {
  u: number;
  v: number;
}

export interface Measuring {
  element: HTMLElement;
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
  element.append(h("span", { class: "segments", role: "group", "aria-label": "Measure" }, probe.button));
  store.on(["aim"], ({ aim }) => probe.show(aim === "probe"));

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
      if (store.state.aim !== "probe" || run < 0 || event.button !== 0) return;
      event.stopImmediatePropagation();
      keep(inScene(run, event.offsetX, event.offsetY));
    },
    { capture: true },
  );
  document.addEventListener("keydown", ({ key }) => key === "Escape" && store.set({ aim: null }));
  return {
    element,
    hover: (pixel) => look(pixel && (() => throughCamera(store, pixel))),
    press(pixel) {
      if (store.state.aim !== "probe") return false;
      keep(throughCamera(store, pixel));
      return true;
    },
  };
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
