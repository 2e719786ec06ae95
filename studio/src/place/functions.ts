// Lighting functions that have a place: primitives, symbols, paths and zones.

import { Box3, Matrix4 } from "three";
import type { Table } from "../model/overrides.ts";
import type { Model } from "../protocol.ts";
import { figure, flat as flatPoint, type Keys, keyed, listed, type Said } from "./keyed.ts";
import type { Thing } from "./thing.ts";
import { shifted } from "./whole.ts";

const SHARED = ["value", "weight", "priority"];
const ON_ROAD: Keys = { x: "x_m", y: "y_m", width: "width_m", length: "length_m" };
const ANGLES: Keys = { roll: "roll_deg", pitch: "pitch_deg", yaw: "yaw_deg" };
const BOX: Keys = { length: "size_m[0]", width: "size_m[1]", height: "size_m[2]" };

export function functionThings(model: Model): Thing[] {
  return Object.entries((model.functions ?? {}) as Record<string, Table>).flatMap(([name, table]) => ofFunction(model, name, table));
}

function ofFunction(model: Model, name: string, table: Table): Thing[] {
  const kind = String(table.kind);
  const thing = { key: `functions.${name}`, title: name, kind, sort: "function" } as const;
  switch (kind) {
    case "primitive":
      return [keyed(model, { ...thing, keys: { ...ON_ROAD, ...ANGLES, z: "z_m" }, others: SHARED })];
    case "symbol":
      if (table.observer) return [seenByObserver(model, thing, table.observer as Table)];
      return [keyed(model, { ...thing, keys: table.controller ? ON_ROAD : { ...ON_ROAD, yaw: "yaw_deg" }, others: SHARED })];
    case "zone":
      return [
        keyed(model, { ...thing, keys: { ...listed("centre_m"), ...ANGLES, ...BOX }, others: ["luminance_cd_m2", "weight", "priority"] }),
      ];
    case "path":
      return pathThings(model, thing, (table.control_m as unknown[]).length);
    default:
      return [placeless(thing, table)];
  }
}

/** What is drawn where objects or the car are. */
function placeless(thing: Said, table: Table): Thing {
  const numbers = Object.entries(table).filter(([, value]) => typeof value === "number");
  return {
    ...thing,
    partOf: null,
    placed: false,
    T: new Matrix4(),
    bounds: new Box3(),
    way: [],
    axes: { move: "", turn: "", scale: "" },
    changes: () => [],
    figures: numbers.map(([name]) => figure(thing.key, name)),
  };
}

/** A picture that stands and faces an eye; the driver's is behind and above the lamps. */
function seenByObserver(model: Model, thing: Said, observer: Table): Thing {
  const [x, y] = observer.centre_m as number[];
  const [eyeX, eyeY] = (observer.name ? [0, 0] : observer.eye_m) as number[];
  const yaw = (Math.atan2(y! - eyeY!, x! - eyeX!) * 180) / Math.PI;
  const keys = { ...listed("observer.centre_m"), width: "observer.width_m", length: "observer.height_m" };
  return keyed(model, { ...thing, keys, fixed: { pitch: -90, yaw }, others: SHARED });
}

function pathThings(model: Model, thing: Said, count: number): Thing[] {
  const points = Array.from({ length: count }, (_, k) => `${thing.key}.control_m[${k}]`);
  const whole = shifted(model, { ...thing, points, others: ["width_m", ...SHARED] });
  const each = points.map((key, k) =>
    keyed(model, { ...thing, key, title: `${thing.title} ${k}`, partOf: thing.key, keys: flatPoint("") }),
  );
  return [whole, ...each];
}
