// Things of several points that move together: paths of light, and the courses of objects.

import { Box3, Matrix4, Vector3 } from "three";
import { valueAt } from "../model/overrides.ts";
import { figure, type Said } from "./keyed.ts";
import { rounded, stepped } from "./poses.ts";
import type { Change, Thing } from "./thing.ts";

export interface Shifted extends Said {
  /** Keys of its points, each a list of two or three numbers. */
  points: string[];
  /** Where it is now, if that is not at its first point. */
  T?: Matrix4;
  bounds?: Box3;
  others?: string[];
}

export function shifted(model: unknown, { points, T, bounds, others = [], partOf = null, ...thing }: Shifted): Thing {
  const first = pointAt(model, points[0]!);
  const now = T ?? new Matrix4().setPosition(first);
  const from = new Vector3().setFromMatrixPosition(now);
  return {
    ...thing,
    partOf,
    placed: true,
    T: now,
    way: points.map((key) => pointAt(model, key).applyMatrix4(now.clone().invert())),
    bounds: bounds ?? new Box3(),
    axes: { move: "XY", turn: "", scale: "" },
    changes: (moved, _, steps = false) => {
      const by = new Vector3().setFromMatrixPosition(moved).sub(from);
      if (steps) by.set(...(by.toArray().map((each) => stepped("x", each)) as [number, number, number]));
      return points.flatMap((key) => movedPoint(model, key, by));
    },
    figures: others.map((name) => figure(thing.key, name)),
  };
}

export function pointAt(model: unknown, key: string): Vector3 {
  const [x = 0, y = 0, z = 0] = (valueAt(model, key) ?? []) as number[];
  return new Vector3(x, y, z);
}

function movedPoint(model: unknown, key: string, by: Vector3): Change[] {
  const numbers = valueAt(model, key) as number[];
  return numbers.flatMap((value, k): Change[] => {
    const next = rounded("x", value + by.getComponent(k));
    return next === rounded("x", value) ? [] : [[`${key}[${k}]`, next]];
  });
}
