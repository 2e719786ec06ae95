// Courses of objects: along clicked points at a speed, from now on; or none, where it stands.

import { Vector3 } from "three";
import { override, type Table, valueAt } from "../model/overrides.ts";
import type { Placing } from "./placing.ts";
import { poseOf, rounded } from "./poses.ts";
import type { Thing } from "./thing.ts";
import { clickWay } from "./way.ts";

const SPEEDS_M_S: Record<string, number> = { car: 10, motorcycle: 10, cyclist: 5, pedestrian: 1.4, animal: 3 };

export function giveCourse(placing: Placing, thing: Thing): void {
  const from = new Vector3().setFromMatrixPosition(thing.T);
  const table = valueAt(placing.store.state.model, thing.key) as Table;
  if (table.on_road) from.z = 0;
  clickWay(placing, `the way of ${thing.title}`, from, (spots) => {
    const points_m = [from, ...spots.map(({ world: [x, y, z] }) => new Vector3(x, y, table.on_road ? 0 : z))].map(({ x, y, z }) =>
      [x, y, z].map((each) => rounded("x", each)),
    );
    const start_s = placing.step?.time_s ?? 0;
    const path = { points_m, speed_m_s: SPEEDS_M_S[thing.kind] ?? 2, start_s: rounded("start", start_s) };
    placing.change([override(`${thing.key}.track`, []), override(`${thing.key}.path`, path)]);
  });
}

/** Let it stand where it is now. */
export function halt(placing: Placing, thing: Thing): void {
  const { x, y, z, yaw } = poseOf(thing.T);
  const table = valueAt(placing.store.state.model, thing.key) as Table;
  const position_m = [x, y, table.on_road ? 0 : z].map((each) => rounded("x", each));
  const track = [{ position_m, yaw_deg: rounded("yaw", yaw) }];
  placing.change([override(`${thing.key}.path`, null), override(`${thing.key}.track`, track)]);
}
