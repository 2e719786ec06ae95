// Handles that move, turn and scale: three.js' TransformControls on a pivot, which stands in the frame of what is chosen.

import { Group, Matrix4, type Mesh, Object3D, Vector3 } from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import type { SceneView } from "../scene/index.ts";
import type { Tool } from "../state.ts";

const MODES = { move: "translate", turn: "rotate", scale: "scale" } as const;
const ONE = new Vector3(1, 1, 1);

export interface Gripped {
  begin(): void;
  /** By which pose of its frame all is moved, and by which scale along its own axes. */
  moved(D: Matrix4, scale: Vector3): void;
  end(): void;
}

export class Gizmo {
  readonly control: TransformControls;
  private readonly base = new Group();
  private readonly pivot = new Object3D();
  private readonly start = new Matrix4();

  constructor(
    private readonly view: SceneView,
    on: Gripped,
  ) {
    this.control = new TransformControls(view.camera, view.canvas);
    this.control.space = "local";
    this.control.setSize(0.85);
    slimmed(this.control);
    this.base.matrixAutoUpdate = false;
    this.base.add(this.pivot);
    view.overlay.add(this.base, this.control.getHelper());
    this.control.addEventListener("change", () => view.redraw());
    this.control.addEventListener("dragging-changed", ({ value }) => {
      view.orbits = !value;
      if (value) {
        this.start.compose(this.pivot.position, this.pivot.quaternion, ONE);
        on.begin();
      } else on.end();
    });
    this.control.addEventListener("objectChange", () => {
      const now = new Matrix4().compose(this.pivot.position, this.pivot.quaternion, ONE);
      on.moved(now.multiply(this.start.clone().invert()), this.pivot.scale.clone());
    });
  }

  get dragging(): boolean {
    return this.control.dragging;
  }

  /** Whether the pointer at a pixel is on a handle. */
  holds(x: number, y: number): boolean {
    if (!this.control.object) return false;
    const { clientWidth, clientHeight } = this.view.canvas;
    const pointer = { x: (2 * x) / clientWidth - 1, y: 1 - (2 * y) / clientHeight, button: 0 };
    this.control.pointerHover(pointer as unknown as PointerEvent);
    return this.control.axis !== null;
  }

  /** Stands at a pose of a frame, that is itself at one of the local frame. While it is dragged, the frame alone is moved. */
  place(T_local_frame: Matrix4, T_frame_pivot: Matrix4, tool: Tool, axes: string): void {
    const { base, pivot, control } = this;
    base.matrix.copy(T_local_frame);
    base.updateMatrixWorld(true);
    if (this.dragging) {
      // from where the control counts, which it knows in the local frame
      const { worldPositionStart } = control as unknown as { worldPositionStart: Vector3 };
      worldPositionStart.setFromMatrixPosition(this.start).applyMatrix4(T_local_frame);
      return;
    }
    T_frame_pivot.decompose(pivot.position, pivot.quaternion, pivot.scale);
    pivot.scale.copy(ONE);
    pivot.updateMatrixWorld(true);
    control.camera = this.view.camera;
    control.mode = MODES[tool];
    [control.showX, control.showY, control.showZ] = ["X", "Y", "Z"].map((axis) => axes.includes(axis)) as [boolean, boolean, boolean];
    control.showE = control.showXYZE = false;
    if (axes && !control.object) control.attach(pivot);
    if (!axes) this.hide();
  }

  hide(): void {
    if (this.control.object && !this.dragging) this.control.detach();
  }
}

/** Arrows are hit on the arrow alone, so that what they stand on can be dragged beside them. */
function slimmed(control: TransformControls): void {
  const [gizmo] = control.getHelper().children as unknown as [{ picker: Record<"translate" | "scale", Object3D> }];
  for (const mode of ["translate", "scale"] as const) {
    for (const each of gizmo.picker[mode].children as Mesh[]) {
      if (!"XYZ".includes(each.name) || each.name.length > 1) continue;
      each.geometry.scale(...(["X", "Y", "Z"].map((axis) => (axis === each.name ? 1 : SLIM)) as [number, number, number]));
    }
  }
}

const SLIM = 0.4;
