// Things whose pose and size are numbers of the model, each with a key of its own.

import { Box3, type Matrix4, Vector3 } from "three";
import { unitOf } from "../model/numbers.ts";
import { valueAt } from "../model/overrides.ts";
import { type Component, matrixOf, type Pose, poseOf, rounded, stepped } from "./poses.ts";
import type { Change, Figure, Thing } from "./thing.ts";

export type Size = "length" | "width" | "height";
/** Keys below the thing's own. */
export type Keys = Partial<Record<Component | Size, string>>;

const SIZES = ["length", "width", "height"] as const; // along x, y and z
const POSE = ["x", "y", "z", "roll", "pitch", "yaw"] as const;
const LEAST = 0.05; // m, of a size

/** What is said of a thing, where all else comes from its keys. */
export type Said = Pick<Thing, "key" | "title" | "kind" | "sort"> & Partial<Pick<Thing, "partOf">>;

export interface Keyed extends Said {
  keys: Keys;
  /** What has no key. */
  fixed?: Partial<Pose>;
  /** Added to the height that the key has. */
  lift?: number;
  /** Its outline, where that is not its size. */
  bounds?: Box3;
  /** Where the foot is at its origin, and not the middle. */
  stands?: boolean;
  /** Names of further numbers that are shown. */
  others?: string[];
}

export function keyed(
  model: unknown,
  { keys, fixed, lift = 0, bounds, stands = false, others = [], partOf = null, ...thing }: Keyed,
): Thing {
  const whole = (name: string) => (name.startsWith("[") ? `${thing.key}${name}` : `${thing.key}.${name}`);
  const at = (component: Component | Size) => {
    const key = keys[component];
    return key === undefined ? undefined : Number(valueAt(model, whole(key)) ?? 0);
  };
  const pose: Partial<Pose> = { ...fixed };
  for (const component of POSE) if (keys[component] !== undefined) pose[component] = at(component);
  const T = matrixOf({ ...pose, z: (pose.z ?? 0) + lift });
  const size = new Vector3(at("length"), at("width"), at("height"));
  const own = new Box3(size.clone().multiplyScalar(-0.5), size.clone().multiplyScalar(0.5));
  if (stands) own.translate(new Vector3(0, 0, size.z / 2));
  const given = new Set<string>(Object.keys(keys));
  return {
    ...thing,
    partOf,
    placed: true,
    T,
    way: [],
    bounds: bounds ?? (size.lengthSq() > 0 ? own : new Box3()),
    axes: {
      move: freeAxes(T, given),
      turn: [given.has("roll") && "X", given.has("pitch") && "Y", given.has("yaw") && "Z"].filter(Boolean).join(""),
      scale: SIZES.map((each, k) => (given.has(each) ? "XYZ"[k] : "")).join(""),
    },
    changes: (moved, scale, steps = false) => changed(keys, whole, at, moved, scale, lift, steps),
    figures: [...named(keys, whole), ...others.map((name) => figure(thing.key, name))],
  };
}

/** Axes of its own along which it can be moved: those in the plane that its keys span. */
function freeAxes(T: Matrix4, given: ReadonlySet<string>): string {
  const e = T.elements;
  const fits = (k: number) => (["x", "y", "z"] as const).every((axis, row) => given.has(axis) || Math.abs(e[4 * k + row]!) < 1e-6);
  return ["X", "Y", "Z"].filter((_, k) => fits(k)).join("");
}

function changed(
  keys: Keys,
  whole: (name: string) => string,
  at: (component: Component | Size) => number | undefined,
  T: Matrix4,
  scale: Vector3,
  lift: number,
  steps: boolean,
): Change[] {
  const pose = poseOf(T);
  pose.z -= lift;
  const found: Change[] = [];
  const put = (component: Component | Size, value: number) => {
    const key = keys[component];
    if (key === undefined) return;
    const next = rounded(component, value);
    if (next === rounded(component, at(component) ?? Number.NaN)) return;
    const step = stepped(component, next);
    const vanishes = step === 0 && SIZES.some((each) => each === component);
    found.push([whole(key), steps && !vanishes ? step : next]);
  };
  for (const component of POSE) put(component, pose[component]);
  SIZES.forEach((each, k) => put(each, Math.max((at(each) ?? 0) * Math.abs(scale.getComponent(k)), Math.min(LEAST, at(each) ?? LEAST))));
  return found;
}

function named(keys: Keys, whole: (name: string) => string): Figure[] {
  const units = (name: string) => (["roll", "pitch", "yaw"].includes(name) ? "°" : "m");
  return [...POSE, ...SIZES].flatMap((name) => {
    const key = keys[name];
    return key === undefined ? [] : [{ key: whole(key), label: name, unit: units(name) }];
  });
}

/** A number of a table that is shown. */
export function figure(table: string, name: string): Figure {
  const { unit, end } = unitOf(name);
  return { key: `${table}.${name}`, label: name.slice(name.lastIndexOf(".") + 1, name.length - end.length).replaceAll("_", " "), unit };
}

/** Keys of a list of three numbers. */
export function listed(list: string): Pick<Keys, "x" | "y" | "z"> {
  return { x: `${list}[0]`, y: `${list}[1]`, z: `${list}[2]` };
}

/** Keys of a point in the plane. */
export function flat(list: string): Pick<Keys, "x" | "y"> {
  return { x: `${list}[0]`, y: `${list}[1]` };
}
