// Probes in the scene: a dot with the illuminance of its curve; and the table of one where a reading was taken.

import { Matrix4, Vector3 } from "three";
import type { Matrix4x4, Vector } from "../arrays.ts";
import { brief } from "../brief.ts";
import type { Table } from "../model/overrides.ts";
import type { Reading } from "../protocol.ts";
import { matrix } from "../scene/frames.ts";
import type { SceneView } from "../scene/index.ts";
import type { Label } from "../scene/labels.ts";
import type { ScenesPanel } from "../scenes/panel.ts";
import type { Studio } from "../state.ts";

const COLOUR = "#ffe08a";

/** Draws the probes of the scenario in the scenes of all runs. */
export function showProbes(store: Studio, scenes: ScenesPanel): void {
  store.on(["model", "step_version", "rows_version", "viewpoint", "scenario"], ({ model, runs }) => {
    const probes = Object.entries((model?.probes ?? {}) as Record<string, Table>);
    scenes.views.forEach((view, run) => {
      const { shown, rows } = runs[run] ?? {};
      if (!shown) return;
      const labels = probes.flatMap(([name, { position_m, frame }]): Label[] => {
        const T = poseOf(String(frame), view, shown.T_world_body);
        if (!T) return [];
        const lx = rows?.column(`probes.${name}.lx`)?.[shown.step] ?? Number.NaN;
        const at = new Vector3(...(position_m as Vector)).applyMatrix4(T).applyMatrix4(view.local(WORLD));
        return [{ at, text: Number.isNaN(lx) ? name : `${name} ${brief(lx)} lx`, colour: COLOUR, symbol: "ring" }];
      });
      view.label("probes", labels);
    });
  });
}

/** Table of a probe that lies where a reading was taken, and rides along with an object; on the wall, with the car. */
export function probeAt({ surface, point_m, normal }: Reading, view: SceneView, T_world_body: Matrix4x4): Table {
  const frame = surface === "road" ? "world" : surface === "wall" ? "car" : surface;
  const T_frame_world = (poseOf(frame, view, T_world_body) ?? new Matrix4()).invert();
  const position = new Vector3(...point_m).applyMatrix4(T_frame_world);
  const facing = new Vector3(...normal).transformDirection(T_frame_world);
  const rounded = (vector: Vector3) => vector.toArray().map((each) => Number(each.toFixed(4)) + 0);
  return { position_m: rounded(position), frame, facing: rounded(facing) };
}

/** Pose in the world of a probe's frame, null where it is not there. */
function poseOf(frame: string, view: SceneView, T_world_body: Matrix4x4): Matrix4 | null {
  if (frame === "world") return new Matrix4();
  return frame === "car" ? matrix(T_world_body) : (view.body(frame)?.T ?? null);
}

const WORLD: Matrix4x4 = new Matrix4().toArray();
