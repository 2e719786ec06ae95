// Measuring where the cursor is: in the scene of each run, and in the camera's picture.

import { Vector3 } from "three";
import { matrix } from "../scene/frames.ts";
import type { ScenesPanel } from "../scenes/panel.ts";
import type { Session } from "../session.ts";
import type { Studio } from "../state.ts";
import { Meter, type Sight } from "./meter.ts";
import { readout } from "./readout.ts";

export interface Measuring {
  element: HTMLElement;
  /** The cursor is on a pixel of the camera's picture, null: it is outside. */
  onCamera(pixel: { u: number; v: number } | null): void;
}

export function measuring(store: Studio, session: Session, scenes: ScenesPanel): Measuring {
  const { element, look } = readout(store, new Meter(store, session));

  /** Through a pixel of a scene's canvas, in CSS pixels. */
  const inScene = (run: number, x: number, y: number): Sight | null => {
    const { viewpoint, rule, side } = store.state;
    const view = scenes.views[run];
    if (!view) return null;
    const isWall = viewpoint === "wall";
    const { eye, through } = view.sight(x, y);
    return { run, on: isWall ? "wall" : "scene", eye_m: eye, through_m: [through], side: isWall && rule ? side : null };
  };
  scenes.body.addEventListener("pointermove", ({ target, offsetX, offsetY }) => {
    const run = scenes.views.findIndex(({ canvas }) => canvas === target);
    look(run < 0 ? null : () => inScene(run, offsetX, offsetY));
  });
  scenes.body.addEventListener("pointerleave", () => look(null));
  return {
    element,
    onCamera: (pixel) => look(pixel && (() => throughCamera(store, pixel))),
  };
}

/** Through the centre of a pixel of the camera's picture. */
function throughCamera(store: Studio, { u, v }: { u: number; v: number }): Sight | null {
  const { scenario, camera_run: run, runs } = store.state;
  const [camera, shown] = [scenario?.runs[run]?.camera, runs[run]?.shown];
  if (!camera || !shown || u < 0 || v < 0 || u >= camera.width || v >= camera.height) return null;
  const T = matrix(shown.T_world_camera);
  const through = new Vector3((u + 0.5 - camera.cx) / camera.fx, (v + 0.5 - camera.cy) / camera.fy, 1).applyMatrix4(T);
  const eye = new Vector3().setFromMatrixPosition(T);
  return { run, on: "scene", eye_m: eye.toArray(), through_m: [through.toArray()], side: null };
}
