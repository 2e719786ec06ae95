// World coordinates near the car: single precision holds a drive of kilometres only if the car stays close to the origin.

import { Matrix4, Vector3 } from "three";
import type { Matrix4x4, Vector } from "../arrays.ts";
import type { Run } from "../protocol.ts";

/** From x forward, y left, z up to the axes of an OpenGL camera: x right, y up, z backward. */
export const OPENGL_FROM_ISO = new Matrix4().set(0, -1, 0, 0, 0, 0, 1, 0, -1, 0, 0, 0, 0, 0, 0, 1);
export const ISO_FROM_OPENGL = OPENGL_FROM_ISO.clone().transpose();

export function degrees(angle: number): number {
  return (angle * Math.PI) / 180;
}

/** Where angles count from, in the frame of the body: the origin of a side's lamp, null: midway between those of all. */
export function reference({ lamps }: Run, side: "left" | "right" | null): Vector3 {
  const origins = Object.entries(lamps).flatMap(([each, origin]) => (each === (side ?? each) ? [new Vector3(...origin)] : []));
  return origins.reduce((sum, each) => sum.add(each), new Vector3()).divideScalar(origins.length || 1);
}

export function matrix(rows: Matrix4x4): Matrix4 {
  return new Matrix4().fromArray(rows).transpose();
}

/** The local frame: axes of the world, origin at whole metres beside the car. */
export class LocalFrame {
  readonly origin = new Vector3();

  moveTo(T_world_body: Matrix4x4): void {
    this.origin.set(Math.round(T_world_body[3] ?? 0), Math.round(T_world_body[7] ?? 0), Math.round(T_world_body[11] ?? 0));
  }

  pose(T_world_any: Matrix4x4): Matrix4 {
    const T = matrix(T_world_any);
    const { elements: e } = T;
    e[12]! -= this.origin.x;
    e[13]! -= this.origin.y;
    e[14]! -= this.origin.z;
    return T;
  }

  point(world: Vector): Vector3 {
    return new Vector3(...world).sub(this.origin);
  }

  world(local: Vector3): Vector {
    return [local.x + this.origin.x, local.y + this.origin.y, local.z + this.origin.z];
  }
}

/** Position and yaw of a pose: what a camera follows that shall neither pitch nor roll. */
export function heading(T: Matrix4): Matrix4 {
  const { elements: e } = T;
  const yaw = Math.atan2(e[1]!, e[0]!);
  return new Matrix4().makeRotationZ(yaw).setPosition(e[12]!, e[13]!, e[14]!);
}
