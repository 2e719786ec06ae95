// A white wall 25 m ahead of the car, as in a light laboratory, with angles and the test points of a regulation.

import {
  BufferGeometry,
  Float32BufferAttribute,
  Group,
  LineBasicMaterial,
  LineSegments,
  type Material,
  type Matrix4,
  Mesh,
  Vector3,
} from "three";
import type { BeamPoint } from "../protocol.ts";
import { degrees } from "./frames.ts";
import type { Label } from "./labels.ts";
import { WALL_M } from "./viewpoints.ts";

const WALL_DEG = { side: 40, bottom: -25, top: 25 };
const GRID_DEG = { step: 5, side: 30, bottom: -10, top: 10 };
const LABELLED_DEG = { row: -7.6, column: -22.2 };
const AXES = [
  { h: 0, v: -9, text: "horizontal angle to the right" },
  { h: -22.2, v: 7.4, text: "angle up" },
];
const BEFORE_M = 0.02; // by which lines stand before the wall

// Blue and orange differ for colour-blind readers as well; the symbols say the same again.
const PASSED = { colour: "#6db6ff", symbol: "disc", word: "passed" } as const;
const FAILED = { colour: "#ff8a3c", symbol: "cross", word: "failed" } as const;
const UNDECIDED = { colour: "#c8ccd4", symbol: "ring", word: "no limit" } as const;

export class Wall {
  /** In the frame of the car's body. */
  readonly group = new Group();
  private readonly grid: LineSegments;
  private readonly axes: LineSegments;
  private points: readonly BeamPoint[] = [];
  private origin = new Vector3(0, 0, 0.65);

  constructor(white: Material) {
    this.group.matrixAutoUpdate = false;
    this.group.visible = false;
    this.group.add(new Mesh(sheet(), white));
    this.grid = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0x8fa3b8, transparent: true, opacity: 0.35 }));
    this.axes = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0xb8c8d8, transparent: true, opacity: 0.75 }));
    this.group.add(this.grid, this.axes);
    this.lookFrom(this.origin);
  }

  place(T_local_body: Matrix4): void {
    this.group.matrix.copy(T_local_body);
    this.group.matrixWorldNeedsUpdate = true;
  }

  setPoints(points: readonly BeamPoint[]): void {
    this.points = points;
  }

  /** Counts angles from a point in the frame of the body: that of one lamp, or the middle of both. */
  lookFrom(origin: Vector3): void {
    this.origin = origin.clone();
    const { step, side, bottom, top } = GRID_DEG;
    const [fine, coarse]: [Vector3[], Vector3[]] = [[], []];
    for (let h = -side; h <= side; h += step) (h === 0 ? coarse : fine).push(this.at(h, bottom), this.at(h, top));
    // A line of equal v is a hyperbola on a flat wall.
    for (let v = bottom; v <= top; v += step) {
      for (let h = -side; h < side; h++) (v === 0 ? coarse : fine).push(this.at(h, v), this.at(h + 1, v));
    }
    this.grid.geometry.setFromPoints(fine);
    this.axes.geometry.setFromPoints(coarse);
  }

  /** Angles along the lower and the left border, and the test points, in the local frame. */
  labels(): Label[] {
    const angles: Label[] = [];
    const colour = "#b8c8d8";
    for (let h = -20; h <= 20; h += GRID_DEG.step) angles.push({ at: this.at(h, LABELLED_DEG.row), text: signed(h), colour });
    for (let v = -5; v <= 5; v += GRID_DEG.step) angles.push({ at: this.at(LABELLED_DEG.column, v), text: signed(v), colour });
    for (const { h, v, text } of AXES) angles.push({ at: this.at(h, v), text, colour });
    const points = this.points.flatMap((point) => (point.where ? [this.label(point, point.where)] : []));
    return [...angles, ...points].map((label) => ({ ...label, at: label.at.applyMatrix4(this.group.matrix) }));
  }

  dispose(): void {
    this.group.traverse((each) => {
      if (each instanceof Mesh || each instanceof LineSegments) each.geometry.dispose();
    });
    for (const lines of [this.grid, this.axes]) (lines.material as LineBasicMaterial).dispose();
  }

  private label({ id, value, unit, limit, passed }: BeamPoint, [h, v]: [number, number]): Label {
    const { colour, symbol, word } = passed === null ? UNDECIDED : passed ? PASSED : FAILED;
    const detail = `${id}: ${Number(value.toPrecision(3))} ${unit}, limit ${limit}, ${word}`;
    return { at: this.at(h, v), text: id, detail, colour, symbol };
  }

  /** Point of the wall at angles in deg, h to the right, v up (type A), in the frame of the body. */
  private at(h: number, v: number): Vector3 {
    const away = WALL_M - BEFORE_M - this.origin.x;
    const [y, z] = [-Math.tan(degrees(h)), Math.tan(degrees(v)) / Math.cos(degrees(h))];
    return new Vector3(1, y, z).multiplyScalar(away).add(this.origin);
  }
}

function signed(angle: number): string {
  return `${angle > 0 ? "+" : angle < 0 ? "−" : ""}${Math.abs(angle)}°`;
}

function sheet(): BufferGeometry {
  const [y, bottom, top] = [WALL_DEG.side, WALL_DEG.bottom, WALL_DEG.top].map((angle) => WALL_M * Math.tan(degrees(angle))) as [
    number,
    number,
    number,
  ];
  const geometry = new BufferGeometry();
  geometry.setAttribute(
    "position",
    new Float32BufferAttribute([WALL_M, y, bottom, WALL_M, -y, bottom, WALL_M, -y, top, WALL_M, y, top], 3),
  );
  geometry.setAttribute("normal", new Float32BufferAttribute(Array.from({ length: 4 }, () => [-1, 0, 0]).flat(), 3));
  geometry.setAttribute("albedo", new Float32BufferAttribute([1, 1, 1, 1], 1));
  geometry.setIndex([0, 1, 2, 0, 2, 3]);
  return geometry;
}
