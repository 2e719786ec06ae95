// Outlines of things in the scene: edges with an arrow ahead, and a faint filling by which they can be seen and hit.

import {
  BoxGeometry,
  BufferGeometry,
  DoubleSide,
  Float32BufferAttribute,
  Group,
  Line,
  LineBasicMaterial,
  LineSegments,
  type Matrix4,
  Mesh,
  MeshBasicMaterial,
  Points,
  PointsMaterial,
  type Raycaster,
  Vector3,
} from "three";
import type { Sort, Thing } from "./thing.ts";

export const COLOURS: Record<Sort, number> = { function: 0xffb454, object: 0x7fd8b4, light: 0xfff1a8, road: 0xc9a27a, car: 0x8fb8ff };
const CHOSEN = 0xffffff;
const DOT_PX = 11;

/** A thing under the pointer, and where, in the local frame. */
export interface Met {
  key: string;
  point: Vector3;
}

interface Drawn {
  group: Group;
  edges: LineSegments<BufferGeometry, LineBasicMaterial>;
  filling: Mesh<BufferGeometry, MeshBasicMaterial>;
  dot: Points<BufferGeometry, PointsMaterial>;
  way: Line<BufferGeometry, LineBasicMaterial>;
}

export class Outlines {
  readonly group = new Group();
  private readonly drawn = new Map<string, Drawn>();

  /** Draws exactly these, each by its pose in the local frame. */
  show(things: readonly Thing[], poseOf: (thing: Thing) => Matrix4, chosen: ReadonlySet<string>): void {
    const left = new Set(this.drawn.keys());
    for (const thing of things) {
      left.delete(thing.key);
      const drawn = this.drawn.get(thing.key) ?? this.another(thing.key);
      place(drawn, thing, poseOf(thing), chosen.has(thing.key));
    }
    for (const key of left) this.forget(key);
  }

  /** Keys of the things under a ray, the nearest first, and where it meets them. */
  under(ray: Raycaster): Met[] {
    this.group.updateMatrixWorld(true);
    const fillings = [...this.drawn.values()].filter(({ filling }) => filling.visible).map(({ filling }) => filling);
    return ray.intersectObjects(fillings, false).map(({ object, point }) => ({ key: object.name, point }));
  }

  dispose(): void {
    for (const key of [...this.drawn.keys()]) this.forget(key);
  }

  private another(key: string): Drawn {
    const line = new LineBasicMaterial({ transparent: true, depthTest: false });
    const faint = new MeshBasicMaterial({ transparent: true, depthTest: false, depthWrite: false, side: DoubleSide });
    const edges = new LineSegments(EDGES, line);
    const filling = new Mesh<BufferGeometry, MeshBasicMaterial>(CUBE, faint);
    const dot = new Points(POINT, new PointsMaterial({ size: DOT_PX, sizeAttenuation: false, transparent: true, depthTest: false }));
    const group = new Group();
    group.matrixAutoUpdate = false;
    filling.name = key;
    for (const each of [edges, filling, dot]) each.frustumCulled = false;
    const way = new Line(new BufferGeometry(), line);
    way.frustumCulled = false;
    group.add(edges, filling, dot, way);
    this.group.add(group);
    const drawn = { group, edges, filling, dot, way };
    this.drawn.set(key, drawn);
    return drawn;
  }

  private forget(key: string): void {
    const drawn = this.drawn.get(key);
    if (!drawn) return;
    this.group.remove(drawn.group);
    for (const { material } of [drawn.edges, drawn.filling, drawn.dot]) material.dispose();
    drawn.way.geometry.dispose();
    this.drawn.delete(key);
  }
}

function place({ group, edges, filling, dot, way }: Drawn, { bounds, sort, way: points }: Thing, T: Matrix4, chosen: boolean): void {
  group.matrix.copy(T);
  group.matrixWorldNeedsUpdate = true;
  const isPoint = bounds.isEmpty();
  edges.visible = filling.visible = !isPoint;
  dot.visible = isPoint;
  const colour = chosen ? CHOSEN : COLOURS[sort];
  for (const { material } of [edges, filling, dot]) material.color.set(colour);
  edges.material.opacity = chosen ? 1 : 0.65;
  filling.material.opacity = sort === "object" ? (chosen ? 0.1 : 0) : chosen ? 0.16 : 0.06;
  for (const each of [edges, filling, dot]) each.renderOrder = chosen ? 3 : 2;
  way.visible = points.length > 0;
  way.renderOrder = 2;
  if (way.visible) {
    way.geometry.dispose();
    way.geometry = new BufferGeometry().setFromPoints(points);
  }
  if (isPoint) return;
  for (const each of [edges, filling]) {
    bounds.getCenter(each.position);
    bounds.getSize(each.scale).max(TINY);
  }
}

const TINY = new Vector3(1e-4, 1e-4, 1e-4);
const CUBE = new BoxGeometry(1, 1, 1);
const POINT = new BufferGeometry().setAttribute("position", new Float32BufferAttribute([0, 0, 0], 3));
const EDGES = new BufferGeometry().setFromPoints([...cube(), ...arrow()]);

function cube(): Vector3[] {
  const ends = [-0.5, 0.5];
  const along = (make: (a: number, b: number, c: number) => Vector3) =>
    ends.flatMap((a) => ends.flatMap((b) => [make(a, b, -0.5), make(a, b, 0.5)]));
  return [
    ...along((a, b, c) => new Vector3(a, b, c)),
    ...along((a, b, c) => new Vector3(a, c, b)),
    ...along((a, b, c) => new Vector3(c, a, b)),
  ];
}

/** At its front, on the ground. */
function arrow(): Vector3[] {
  const [left, tip, right] = [new Vector3(0.5, 0.18, -0.5), new Vector3(0.62, 0, -0.5), new Vector3(0.5, -0.18, -0.5)];
  return [left, tip, tip, right];
}
