// The pointer in the scene: a click chooses, a drag on what is chosen moves it over the plane that it stands on.

import { Matrix4, Plane, Vector3 } from "three";
import type { Placing } from "./placing.ts";

const STILL_PX = 4;

export function bindPointer(placing: Placing): void {
  const { view, gizmo } = placing;
  const { canvas } = view;
  let down: { x: number; y: number; held: boolean } | null = null;
  let grabbed: { from: Vector3; plane: Plane } | null = null;

  /** Where the ray of sight meets the plane of what is grabbed, in its frame. */
  const meet = (x: number, y: number, plane: Plane): Vector3 | null => {
    const ray = view.ray(x, y).ray.clone().applyMatrix4(placing.frame(placing.base).invert());
    return ray.intersectPlane(plane, new Vector3());
  };

  // Before the orbit camera and the gizmo, which listen for the same events.
  const capture = { capture: true };
  for (const event of ["pointerdown", "pointermove"] as const) {
    canvas.addEventListener(event, ({ ctrlKey }) => (placing.free = ctrlKey), capture);
  }
  canvas.addEventListener(
    "pointerdown",
    (event) => {
      if (event.button !== 0) return;
      const { offsetX: x, offsetY: y } = event;
      down = { x, y, held: gizmo.holds(x, y) };
      grabbed = null;
      const [top] = placing.under(x, y);
      const chosen = placing.chosen.map(({ key }) => key);
      if (down.held || event.shiftKey || placing.clicking || !placing.steers || !top || !chosen.includes(top.key)) return;
      const at = top.point.clone().applyMatrix4(placing.frame(placing.base).invert());
      const plane = new Plane().setFromNormalAndCoplanarPoint(new Vector3(0, 0, 1), at);
      const from = meet(x, y, plane);
      if (!from) return;
      grabbed = { from, plane };
      view.orbits = false;
      canvas.setPointerCapture(event.pointerId);
    },
    capture,
  );
  canvas.addEventListener("pointermove", ({ offsetX: x, offsetY: y }) => {
    if (!grabbed || !down) return;
    if (!placing.isDragging) {
      if (Math.hypot(x - down.x, y - down.y) < STILL_PX) return;
      placing.begin();
    }
    const to = meet(x, y, grabbed.plane);
    if (to) placing.moved(new Matrix4().makeTranslation(to.sub(grabbed.from)));
  });
  const release = (event: PointerEvent) => {
    const began = down;
    down = null;
    if (grabbed) {
      grabbed = null;
      view.orbits = true;
      if (placing.isDragging) {
        placing.end();
        return;
      }
    }
    if (event.type !== "pointerup" || !began || began.held || event.button !== 0) return;
    const { offsetX: x, offsetY: y } = event;
    if (Math.hypot(x - began.x, y - began.y) < STILL_PX) click(placing, x, y, event.shiftKey);
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
}

/** Choose what is there, and what is behind it where that is chosen already. */
function click(placing: Placing, x: number, y: number, more: boolean): void {
  if (placing.clicking) {
    placing.clicking.click(x, y);
    return;
  }
  const keys = placing.under(x, y).map(({ key }) => key);
  const { chosen } = placing.store.state;
  const next = chosen.length === 1 && !more ? keys[(keys.indexOf(chosen[0]!) + 1) % keys.length] : keys[0];
  if (next !== undefined) placing.choose(next, more);
  else if (!more) placing.choose(null);
}
