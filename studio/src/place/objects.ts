// Objects of the scenario. One that stands is moved by its only pose; of one that moves, the whole course is, or its points one by one.

import { Matrix4, Vector3 } from "three";
import type { Table } from "../model/overrides.ts";
import type { Model } from "../protocol.ts";
import { type Keys, keyed, listed } from "./keyed.ts";
import type { Standing, Thing } from "./thing.ts";
import { pointAt, shifted } from "./whole.ts";

const ANGLES: Keys = { roll: "track[0].roll_deg", pitch: "track[0].pitch_deg", yaw: "track[0].yaw_deg" };
const BOX: Keys = { length: "size_m[0]", width: "size_m[1]", height: "size_m[2]" };

export function objectThings(model: Model, told: Model, standing: Standing): Thing[] {
  return ((model.objects ?? []) as Table[]).flatMap((table, k) => ofObject(model, told, standing, table, `objects[${k}]`));
}

function ofObject(model: Model, told: Model, there: Standing, table: Table, key: string): Thing[] {
  const name = String(table.name);
  const body = there.body(name);
  const thing = { key, title: name, kind: String(table.kind), sort: "object" } as const;
  const track = table.track as Table[];
  if (track.length === 1) {
    const keys = { ...listed("track[0].position_m"), ...ANGLES, ...(table.kind === "box" ? BOX : {}) };
    const lift = table.on_road && body ? body.T.elements[14]! - pointAt(told, `${key}.track[0].position_m`).z : 0;
    const bounds = table.kind === "box" ? undefined : body?.bounds;
    const standing = keyed(model, { ...thing, keys, lift, bounds, stands: true });
    return [{ ...standing, axes: { ...standing.axes, move: "XY" } }]; // its height is a number
  }
  const path = table.path as Table | null;
  const points = path
    ? (path.points_m as unknown[]).map((_, k) => `${key}.path.points_m[${k}]`)
    : track.map((_, k) => `${key}.track[${k}].position_m`);
  const others = path ? ["path.speed_m_s", "path.start_s"] : [];
  const by = pointAt(model, points[0]!).sub(pointAt(told, points[0]!));
  const T = body && new Matrix4().makeTranslation(by).multiply(body.T);
  const whole = shifted(model, { ...thing, points, T: T ?? undefined, bounds: body?.bounds, others });
  const each = points.map((point, k) =>
    keyed(model, {
      ...thing,
      key: point,
      title: `${name} ${k}`,
      partOf: key,
      keys: listed(""),
      lift: table.on_road && T ? height(T) - pointAt(model, point).z : 0,
    }),
  );
  return [whole, ...each];
}

function height(T: Matrix4): number {
  return new Vector3().setFromMatrixPosition(T).z;
}
