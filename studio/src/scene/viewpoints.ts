// Where the scene is looked at from.

import { type Camera, Matrix4, OrthographicCamera, PerspectiveCamera, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { degrees, heading } from "./frames.ts";

export type Viewpoint = "orbit" | "above" | "driver" | "oncoming" | "wall";

export const WALL_M = 25;
const ORBIT_FROM = new Vector3(-13, 0, 6.5);
const ORBIT_AT = new Vector3(14, 0, 0);
const DRIVER = new Vector3(-1.9, 0.37, 1.2);
const ONCOMING = new Vector3(50, 3.5, 1.2);
const ONCOMING_AT = new Vector3(0, 0, 0.65);
const ABOVE = { height: 150, extent: 80, least: 12, most: 240, behind: 0.12 };
const WALL_DEG = { side: 24, bottom: -8, top: 6 };
const WHOLE_WALL = { zoom: 1, x: 0, y: 0 } as const;
const MOST_WALL_ZOOM = 24;

/** Where the orbit camera stands and what it looks at, in m ahead of the car, to its left and up. */
export interface Orbit {
  eye: Vector3;
  target: Vector3;
}

/** What a viewpoint depends on, in the local frame. */
export interface Car {
  T_local_ground: Matrix4;
  T_local_body: Matrix4;
  lamp_height_m: number;
}

export class Viewpoints {
  viewpoint: Viewpoint = "orbit";
  private readonly orbit = new PerspectiveCamera(45, 1, 0.2, 1500);
  private readonly fixed = new PerspectiveCamera(40, 1, 0.1, 1500);
  private readonly flat = new OrthographicCamera(-1, 1, 1, -1, 0.1, 600);
  private readonly controls: OrbitControls;
  private readonly wheel = (event: WheelEvent) => this.onWheel(event);
  private readonly fit = () => {
    if (!this.isFlat) return;
    this.wall = { ...WHOLE_WALL };
    this.above_m = ABOVE.extent;
    this.reframe();
  };
  private readonly pan = (event: PointerEvent) => this.onPan(event);
  private readonly T_local_heading = new Matrix4();
  private car: Car = { T_local_ground: new Matrix4(), T_local_body: new Matrix4(), lamp_height_m: 0.65 };
  /** Called when the user moves the orbit camera. */
  onMove: ((orbit: Orbit) => void) | null = null;
  /** Called when another part of the wall or of the ground from above is shown. */
  onFrame: (() => void) | null = null;
  private moving = false; // by the program
  private aspect = 1;
  private above_m = ABOVE.extent;
  /** Middle of what is shown of the wall, in m to the right and up from the middle of all. */
  private wall: { zoom: number; x: number; y: number } = { ...WHOLE_WALL };
  private panned: PointerEvent | null = null;

  constructor(
    private readonly canvas: HTMLElement,
    private readonly changed: () => void,
  ) {
    for (const camera of [this.orbit, this.fixed, this.flat]) camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.orbit, canvas);
    this.controls.maxDistance = 300;
    this.controls.minDistance = 1;
    this.controls.maxPolarAngle = degrees(89.5);
    this.controls.addEventListener("change", () => {
      if (!this.moving) this.onMove?.(this.orbiting());
      changed();
    });
    canvas.addEventListener("wheel", this.wheel, { passive: false });
    canvas.addEventListener("dblclick", this.fit);
    canvas.addEventListener("pointerdown", this.pan);
    canvas.addEventListener("pointermove", this.pan);
    this.setOrbit({ eye: ORBIT_FROM, target: ORBIT_AT });
  }

  get camera(): Camera {
    if (this.viewpoint === "orbit") return this.orbit;
    return this.viewpoint === "above" || this.viewpoint === "wall" ? this.flat : this.fixed;
  }

  /** Whether rays to the eye are parallel. */
  get isFlat(): boolean {
    return this.camera === this.flat;
  }

  /** Whether dragging moves the orbit camera. */
  set orbits(enabled: boolean) {
    this.controls.enabled = enabled && this.viewpoint === "orbit";
  }

  set(viewpoint: Viewpoint): void {
    this.viewpoint = viewpoint;
    this.orbits = true;
    this.place();
  }

  /** Puts the orbit camera to a place beside the car. */
  setOrbit({ eye, target }: Orbit): void {
    this.orbit.position.copy(eye).applyMatrix4(this.T_local_heading);
    this.controls.target.copy(target).applyMatrix4(this.T_local_heading);
    this.moving = true;
    this.controls.update();
    this.moving = false;
  }

  /** Moves all cameras with the car; both poses are in the local frames of their own steps. */
  follow(car: Car): void {
    this.car = car;
    const orbit = this.orbiting();
    this.T_local_heading.copy(heading(car.T_local_ground));
    this.setOrbit(orbit);
    this.place();
  }

  resize(aspect: number): void {
    this.aspect = aspect;
    for (const camera of [this.orbit, this.fixed]) {
      camera.aspect = aspect;
      camera.updateProjectionMatrix();
    }
    this.place();
  }

  dispose(): void {
    this.controls.dispose();
    this.canvas.removeEventListener("wheel", this.wheel);
    this.canvas.removeEventListener("dblclick", this.fit);
    this.canvas.removeEventListener("pointerdown", this.pan);
    this.canvas.removeEventListener("pointermove", this.pan);
  }

  private orbiting(): Orbit {
    const T_heading_local = this.T_local_heading.clone().invert();
    return {
      eye: this.orbit.position.clone().applyMatrix4(T_heading_local),
      target: this.controls.target.clone().applyMatrix4(T_heading_local),
    };
  }

  private place(): void {
    const { T_local_body, lamp_height_m } = this.car;
    const at = (point: Vector3, frame: Matrix4) => point.clone().applyMatrix4(frame);
    if (this.viewpoint === "above") {
      this.flat.up.set(1, 0, 0).transformDirection(this.T_local_heading);
      this.flat.position.copy(at(new Vector3(0, 0, ABOVE.height), this.T_local_heading));
      this.flat.lookAt(at(new Vector3(), this.T_local_heading));
      const [behind, ahead] = [ABOVE.behind * this.above_m, (1 - ABOVE.behind) * this.above_m];
      const half = (this.above_m * this.aspect) / 2;
      this.frame(-half, half, -behind, ahead);
    } else if (this.viewpoint === "wall") {
      const eye = at(new Vector3(0, 0, lamp_height_m), T_local_body);
      this.flat.up.set(0, 0, 1).transformDirection(T_local_body);
      this.flat.position.copy(eye);
      this.flat.lookAt(at(new Vector3(WALL_M, 0, lamp_height_m), T_local_body));
      const { left, right, bottom, top } = this.onWall;
      this.frame(left, right, bottom, top);
    } else if (this.viewpoint === "driver") {
      this.fixed.fov = 36;
      this.fixed.up.set(0, 0, 1).transformDirection(T_local_body);
      this.fixed.position.copy(at(DRIVER, T_local_body));
      this.fixed.lookAt(at(DRIVER.clone().add(new Vector3(20, 0, -0.9)), T_local_body));
      this.fixed.updateProjectionMatrix();
    } else if (this.viewpoint === "oncoming") {
      this.fixed.fov = 20;
      this.fixed.up.set(0, 0, 1);
      this.fixed.position.copy(at(ONCOMING, this.T_local_heading));
      this.fixed.lookAt(at(ONCOMING_AT, this.T_local_heading));
      this.fixed.updateProjectionMatrix();
    }
    this.camera.updateMatrixWorld();
  }

  private frame(left: number, right: number, bottom: number, top: number): void {
    Object.assign(this.flat, { left, right, bottom, top });
    this.flat.updateProjectionMatrix();
  }

  private onWheel(event: WheelEvent): void {
    if (!this.isFlat) return;
    event.preventDefault();
    const factor = Math.exp(Math.sign(event.deltaY) * 0.12);
    if (this.viewpoint === "above") this.above_m = Math.min(Math.max(this.above_m * factor, ABOVE.least), ABOVE.most);
    else {
      const under = this.wallPoint(event);
      this.wall.zoom = Math.min(Math.max(this.wall.zoom / factor, 1), MOST_WALL_ZOOM);
      this.moveWall(under, this.wallPoint(event));
    }
    this.reframe();
  }

  private reframe(): void {
    this.place();
    this.onFrame?.();
    this.changed();
  }

  /** Borders of what is shown of the wall, in m to the right of the car's axis and up from the lamps. */
  get onWall(): { left: number; right: number; bottom: number; top: number } {
    const y = (angle: number) => WALL_M * Math.tan(degrees(angle));
    const [least, most, side] = [y(WALL_DEG.bottom), y(WALL_DEG.top), y(WALL_DEG.side)];
    const whole = Math.max((most - least) / 2, side / this.aspect);
    const high = whole / this.wall.zoom;
    const kept = (at: number, room: number) => Math.min(Math.max(at, -room), room);
    const x = kept(this.wall.x, (whole - high) * this.aspect);
    const middle = (most + least) / 2 + kept(this.wall.y, whole - high);
    return { left: x - high * this.aspect, right: x + high * this.aspect, bottom: middle - high, top: middle + high };
  }

  /** Point of the wall below the pointer, as of `onWall`. */
  private wallPoint({ offsetX, offsetY }: MouseEvent): { x: number; y: number } {
    const { left, right, bottom, top } = this.onWall;
    const { clientWidth, clientHeight } = this.canvas;
    return { x: left + ((right - left) * offsetX) / clientWidth, y: top - ((top - bottom) * offsetY) / clientHeight };
  }

  /** Show a point of the wall where another one is. */
  private moveWall(point: { x: number; y: number }, at: { x: number; y: number }): void {
    this.wall.x += point.x - at.x;
    this.wall.y += point.y - at.y;
  }

  private onPan(event: PointerEvent): void {
    const before = this.panned;
    this.panned = event.buttons & 1 ? event : null;
    if (this.viewpoint !== "wall" || !before || !this.panned || event.type === "pointerdown") return;
    this.moveWall(this.wallPoint(before), this.wallPoint(event));
    this.reframe();
  }
}
