// Lines and dots that are not lit: the car's outline, its lamps, the camera's field, lamps of others.

import {
  BufferGeometry,
  Float32BufferAttribute,
  Group,
  LineBasicMaterial,
  LineSegments,
  type Matrix4,
  Points,
  PointsMaterial,
  Vector3,
} from "three";
import type { Camera, Module } from "../protocol.ts";
import type { Viewpoint } from "./viewpoints.ts";

const CAR = { front: 0.05, rear: -4.35, side: 0.9, bottom: 0.25, top: 1.45 };
const FRUSTUM_M = 12;
const FIELD_M = 8;

export class Markers {
  readonly group = new Group();
  private readonly car = lines(0x7d8ea3, box());
  private readonly frustum = lines(0x4fb3ff, []);
  private readonly fields = lines(0x8a7448, []);
  private readonly lamps = dots(0xffd58a, 5);
  private readonly others = dots(0xffffff, 4);

  constructor() {
    this.group.add(this.car, this.frustum, this.fields, this.lamps, this.others);
    this.car.matrixAutoUpdate = this.frustum.matrixAutoUpdate = false;
  }

  setCamera({ width, height, fx, fy, cx, cy }: Camera): void {
    const corner = (u: number, v: number) => new Vector3((u - cx) / fx, (v - cy) / fy, 1).multiplyScalar(FRUSTUM_M);
    const corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
    redraw(this.frustum, pyramid(new Vector3(), corners));
  }

  /** Fields of the modules. */
  setFields(modules: readonly Module[], T_local_module: readonly Matrix4[]): void {
    const edges = modules.flatMap(({ left, right, bottom, top }, k) => {
      const T = T_local_module[k]!;
      const tangents = [
        [left, top],
        [right, top],
        [right, bottom],
        [left, bottom],
      ] as const;
      const corners = tangents.map(([y, z]) => new Vector3(1, y, z).setLength(FIELD_M).applyMatrix4(T));
      return pyramid(new Vector3().setFromMatrixPosition(T), corners);
    });
    redraw(this.fields, edges);
  }

  /** Places all in the local frame. */
  place(T_local_body: Matrix4, T_local_camera: Matrix4, lamps: readonly Vector3[], others: readonly Vector3[]): void {
    for (const [object, T] of [
      [this.car, T_local_body],
      [this.frustum, T_local_camera],
    ] as const) {
      object.matrix.copy(T);
      object.matrixWorldNeedsUpdate = true;
    }
    replace(this.lamps, lamps);
    replace(this.others, others);
  }

  /** What a viewpoint shows: an eye within the car does not see its outline. */
  show(viewpoint: Viewpoint, frusta: boolean): void {
    this.group.visible = viewpoint !== "wall";
    this.car.visible = this.lamps.visible = viewpoint !== "driver";
    this.fields.visible = this.frustum.visible = frusta && viewpoint !== "driver";
  }

  dispose(): void {
    for (const object of [this.car, this.frustum, this.fields, this.lamps, this.others]) {
      object.geometry.dispose();
      (object.material as LineBasicMaterial | PointsMaterial).dispose();
    }
  }
}

function lines(color: number, points: Vector3[]): LineSegments {
  const object = new LineSegments(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color }));
  object.frustumCulled = false;
  return object;
}

function redraw(object: LineSegments, points: Vector3[]): void {
  object.geometry.dispose();
  object.geometry = new BufferGeometry().setFromPoints(points);
}

/** Edges from a tip to four corners and between these. */
function pyramid(tip: Vector3, corners: Vector3[]): Vector3[] {
  return corners.flatMap((each, i) => [tip, each, each, corners[(i + 1) % 4]!]);
}

function dots(color: number, size: number): Points {
  const object = new Points(new BufferGeometry(), new PointsMaterial({ color, size, sizeAttenuation: false }));
  object.frustumCulled = false;
  return object;
}

function replace(object: Points, points: readonly Vector3[]): void {
  object.geometry.dispose();
  object.geometry = new BufferGeometry();
  object.geometry.setAttribute(
    "position",
    new Float32BufferAttribute(
      points.flatMap((point) => point.toArray()),
      3,
    ),
  );
}

/** Edges of the car's bounding box in the frame of its body. */
function box(): Vector3[] {
  const { front, rear, side, bottom, top } = CAR;
  const ring = [
    [front, side],
    [front, -side],
    [rear, -side],
    [rear, side],
  ] as const;
  return ring.flatMap(([x, y], i) => {
    const [nextX, nextY] = ring[(i + 1) % 4]!;
    const edge = (z: number) => [new Vector3(x, y, z), new Vector3(nextX, nextY, z)];
    return [...edge(bottom), ...edge(top), new Vector3(x, y, bottom), new Vector3(x, y, top)];
  });
}
