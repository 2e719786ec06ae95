// What can be chosen and moved in the scene.

import type { Box3, Matrix4, Vector3 } from "three";

export type Sort = "function" | "object" | "light" | "road" | "car";
/** The ground below the car, which moves with it; the world; or the car's body. */
export type Frame = "ground" | "world" | "body";

/** Frames in which the keys are. */
export const FRAMES: Record<Sort, Frame> = { function: "ground", object: "world", light: "world", road: "world", car: "body" };

/** A key and its new value. */
export type Change = readonly [key: string, value: number];

export interface Figure {
  key: string;
  label: string;
  unit: string;
}

export interface Thing {
  /** Key of its table. */
  key: string;
  title: string;
  kind: string;
  sort: Sort;
  /** Pose in its frame. */
  T: Matrix4;
  /** Outline in its own frame; a point where it is empty. */
  bounds: Box3;
  /** Points that it goes through, in its own frame. */
  way: Vector3[];
  /** Axes along which it can be moved and scaled, and about which it can be turned. */
  axes: { move: string; turn: string; scale: string };
  /** Whether it is drawn; what has no place of its own is listed alone. */
  placed: boolean;
  /** Things that are a part of another are shown only while that or another part of it is chosen. */
  partOf: string | null;
  /** What is changed by another pose in its frame, and by a scale along its axes, in whole steps or by any amount. */
  changes(T: Matrix4, scale: Vector3, steps?: boolean): Change[];
  figures: Figure[];
}

/** What stands in the scene now. */
export interface Standing {
  /** Pose in the world and outline of an object by its name, null where it is not there now. */
  body(name: string): { T: Matrix4; bounds: Box3 } | null;
}
