// Poses as scenarios have them: metres, and roll, pitch and yaw in degrees, applied in this order about the axes x, y and z.

import { Euler, Matrix4, Quaternion, Vector3 } from "three";
import { degrees } from "../scene/frames.ts";

export type Component = "x" | "y" | "z" | "roll" | "pitch" | "yaw";
export type Pose = Record<Component, number>;

const AXES = ["x", "y", "z"] as const;
const ANGLES = ["roll", "pitch", "yaw"] as const;

export function matrixOf(pose: Partial<Pose>): Matrix4 {
  const { x = 0, y = 0, z = 0, roll = 0, pitch = 0, yaw = 0 } = pose;
  const R = new Matrix4().makeRotationFromEuler(new Euler(degrees(roll), degrees(pitch), degrees(yaw), "ZYX"));
  return R.setPosition(x, y, z);
}

export function poseOf(T: Matrix4): Pose {
  const [position, turn] = [new Vector3(), new Quaternion()];
  T.decompose(position, turn, new Vector3());
  const euler = new Euler().setFromQuaternion(turn, "ZYX");
  const angles = ANGLES.map((name, k) => [name, (euler.toArray()[k] as number) * (180 / Math.PI)] as const);
  return Object.fromEntries([...AXES.map((axis) => [axis, position[axis]] as const), ...angles]) as Pose;
}

/** Steps that dragging keeps to. */
const STEPS = { m: 0.1, deg: 5 } as const;

/** To a tenth of a metre or five degrees. */
export function stepped(component: string, value: number): number {
  const step = ANGLES.includes(component as (typeof ANGLES)[number]) ? STEPS.deg : STEPS.m;
  return rounded(component, step * Math.round(value / step));
}

/** To the millimetre or a hundredth of a degree, so that keys stay short. */
export function rounded(component: string, value: number): number {
  const digits = ANGLES.includes(component as (typeof ANGLES)[number]) ? 2 : 3;
  return Number(value.toFixed(digits)) + 0;
}
