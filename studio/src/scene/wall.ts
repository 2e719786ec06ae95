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
import { SOLID } from "./bodies.ts";
import { degrees } from "./frames.ts";
import type { Label } from "./labels.ts";
import { WALL_M } from "./viewpoints.ts";

const WALL_DEG = { side: 40, bottom: -25, top: 25 };
const GRID_DEG = { side: 30, bottom: -10, top: 10 };
const STEPS_DEG = [0.1, 0.2, 0.5, 1, 2, 5] as const;
const MOST_LINES = 10; // across
const LABELLED = 0.05; // share of what is shown between its left border and the numbers
const LOW = { numbers: 0.09, name: 0.04 }; // shares between its lower border and the numbers and the name of their axis
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
  private step_deg = 5;

  constructor(white: Material) {
    this.group.matrixAutoUpdate = false;
    this.group.visible = false;
    const wall = new Mesh(sheet(), white);
    wall.layers.enable(SOLID);
    this.group.add(wall);
    this.grid = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0x8fa3b8, transparent: true, opacity: 0.35 }));
    this.axes = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0xb8c8d8, transparent: true, opacity: 0.75 }));
    this.group.add(this.grid, this.axes);
    this.lookFrom(this.origin, 1);
  }

  place(T_local_body: Matrix4): void {
    this.group.matrix.copy(T_local_body);
    this.group.matrixWorldNeedsUpdate = true;
  }

  setPoints(points: readonly BeamPoint[]): void {
    this.points = points;
  }

  /** Counts angles from a point in the frame of the body: that of one lamp, or the middle of both. width_m: of what is shown. */
  lookFrom(origin: Vector3, width_m: number): void {
    const across_deg = (2 * Math.atan(width_m / 2 / WALL_M) * 180) / Math.PI;
    const step = STEPS_DEG.find((each) => each >= across_deg / MOST_LINES) ?? 5;
    if (this.origin.equals(origin) && this.step_deg === step) return;
    this.origin = origin.clone();
    this.step_deg = step;
    const { side, bottom, top } = GRID_DEG;
    const [fine, coarse]: [Vector3[], Vector3[]] = [[], []];
    for (const h of multiples(-side, side, step)) (h === 0 ? coarse : fine).push(this.at(h, bottom), this.at(h, top));
    // A line of equal v is a hyperbola on a flat wall.
    for (const v of multiples(bottom, top, step)) {
      for (let h = -side; h < side; h++) (v === 0 ? coarse : fine).push(this.at(h, v), this.at(h + 1, v));
    }
    for (const [lines, points] of [
      [this.grid, fine],
      [this.axes, coarse],
    ] as const) {
      lines.geometry.dispose();
      lines.geometry = new BufferGeometry().setFromPoints(points);
    }
  }

  /**
   * Angles along the lower and the left border, and the test points, in the local frame. shown: borders of what is shown, in m to the right
   * and up from the height of the lamps.
   */
  labels(shown: { left: number; right: number; bottom: number; top: number }, height_m: number): Label[] {
    const angles: Label[] = [];
    const colour = "#b8c8d8";
    const { origin, step_deg } = this;
    const { side, bottom, top } = GRID_DEG;
    const height = shown.top - shown.bottom;
    const left = shown.left + LABELLED * (shown.right - shown.left);
    const low = Math.max(height_m + shown.bottom + LOW.numbers * height, this.at(0, bottom).z);
    const away = WALL_M - BEFORE_M - origin.x;
    for (const h of multiples(-side, side, step_deg)) {
      const { x, y } = this.at(h, 0);
      if (-y > left) angles.push({ at: new Vector3(x, y, low), text: signed(h), colour });
    }
    const at_left = (Math.atan2(left + origin.y, away) * 180) / Math.PI;
    for (const v of multiples(bottom, top, step_deg)) {
      const at = this.at(at_left, v);
      if (at.z > low + LABELLED * height) angles.push({ at, text: signed(v), colour });
    }
    const named = (right: number, z: number, text: string) => angles.push({ at: new Vector3(WALL_M - BEFORE_M, -right, z), text, colour });
    named((shown.left + shown.right) / 2, low - (LOW.numbers - LOW.name) * height, "horizontal angle to the right");
    named(left, height_m + shown.top - LOW.name * height, "angle up");
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

/** Multiples of a step from one to the other. */
function multiples(from: number, to: number, step: number): number[] {
  const first = Math.ceil(from / step - 1e-9);
  const count = Math.floor(to / step + 1e-9) - first + 1;
  return Array.from({ length: Math.max(count, 0) }, (_, k) => Number(((first + k) * step).toFixed(3)) + 0);
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
