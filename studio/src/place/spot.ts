// A place that was clicked in the scene.

import { Matrix4, Vector3 } from "three";
import type { Table } from "../model/overrides.ts";
import type { Placing } from "./placing.ts";
import { poseOf, rounded, stepped } from "./poses.ts";

const LEVEL = 0.99; // least upward part of the normal of a surface on which places are in steps; beside others a step would leave it

/** Where it is added. ground: below the car; facing: yaw in degrees of the way back to the car. */
export interface Spot {
  ground: [number, number, number];
  world: [number, number, number];
  /** Heading of the car in the world. */
  heading_deg: number;
  /** Roll, pitch and yaw of a rectangle that lies on what was clicked, in the ground's frame. */
  lies: { pitch_deg: number; yaw_deg: number };
  /** The object that was clicked. */
  object: Table | null;
}

/** What is under a pixel, null where there is nothing. */
export function spotAt(placing: Placing, x: number, y: number): Spot | null {
  const { view } = placing;
  const T_local_ground = placing.frame("ground");
  const T_ground_local = T_local_ground.clone().invert();
  const T_world_local = placing.frame("world").invert();
  const hit = view.hit(x, y);
  if (!hit) return null;
  const local = new Vector3(...hit.point).applyMatrix4(T_world_local.clone().invert());
  const normal = new Vector3(...hit.normal).transformDirection(T_ground_local);
  const heading = poseOf(T_world_local.clone().multiply(T_local_ground));
  const place = placing.free || normal.z < LEVEL ? rounded : stepped;
  const at = ({ x, y, z }: Vector3): [number, number, number] => [place("x", x), place("y", y), rounded("z", z)];
  return {
    ground: at(local.clone().applyMatrix4(T_ground_local)),
    world: at(local.clone().applyMatrix4(T_world_local)),
    heading_deg: heading.yaw,
    lies: lying(normal),
    object: placing.tableOf(hit.object),
  };
}

/** Attitude of a rectangle with this normal whose first row is on top. */
export function lying(normal: Vector3): { pitch_deg: number; yaw_deg: number } {
  const up = new Vector3(0, 0, 1);
  const ahead = up.clone().addScaledVector(normal, -up.dot(normal)); // up the surface
  if (ahead.length() < 1e-3) return { pitch_deg: 0, yaw_deg: 0 };
  ahead.normalize();
  const { pitch, yaw, roll } = poseOf(new Matrix4().makeBasis(ahead, normal.clone().cross(ahead), normal));
  return Math.abs(pitch) > 89.999
    ? { pitch_deg: -90, yaw_deg: rounded("yaw", yaw - roll) }
    : { pitch_deg: rounded("pitch", pitch), yaw_deg: rounded("yaw", yaw) };
}
