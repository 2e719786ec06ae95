// Painting light in the world: a click on a place lights it by the pixels that reach it, a brush says how bright road or wall shall be.

import { Matrix4, Vector3 } from "three";
import type { Vector } from "../arrays.ts";
import { brief } from "../brief.ts";
import { h, numberField, numberOf, toggle } from "../dom.ts";
import type { Painting } from "../matrix/painting.ts";
import type { PlaceMessage, StepMessage } from "../protocol.ts";
import type { SceneView } from "../scene/index.ts";
import { WALL_M } from "../scene/viewpoints.ts";
import type { ScenesPanel } from "../scenes/panel.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio } from "../state.ts";
import { Turns } from "../turns.ts";
import { Raster, type Surface } from "./raster.ts";
import { WishPlane } from "./wish_plane.ts";

const MODES = {
  find: "A click on the road, an object or the wall frames the pixels that light it",
  light: "Paint the pixels that light what you click on",
  lux: "Paint the illuminance wanted on the road, or on the wall in its view",
} as const;
type Mode = keyof typeof MODES;
const ANSWER_MS = 5000;
const T_BODY_WALL = new Matrix4().set(0, 0, -1, WALL_M, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1);

export function worldLight(
  store: Studio,
  session: Session,
  scenes: ScenesPanel,
  painting: Painting,
): { rasters: Readonly<Record<Surface, Raster>> } {
  const rasters = { road: new Raster("road"), wall: new Raster("wall") };
  const raster = () => rasters[store.state.viewpoint === "wall" ? "wall" : "road"];
  const planes = new Map<SceneView, WishPlane[]>();
  const mode = (): Mode | null => {
    const { aim } = store.state;
    return aim !== null && aim in MODES ? (aim as Mode) : null;
  };
  let waiting: Vector | null = null;

  const utilisation = numberField("Utilisation that is painted, in per cent", { value: 100, min: 0, max: 100, step: 5 });
  const lx = numberField("Illuminance that is wanted, in lx; nothing: none is wanted", { value: 1, min: 0, max: 1000, step: "any" });
  const radius = numberField("Radius of the brush, in m", { value: 1, min: 0.3, max: 10, step: "any" });
  const told = h("output", { class: "readout" });
  const buttons = (Object.keys(MODES) as Mode[]).map((each) => ({
    each,
    ...toggle(each, MODES[each], (on) => store.set({ aim: on ? each : null })),
  }));
  const share = h("label", {}, "%", utilisation);
  const brush = h(
    "span",
    { class: "brush" },
    h("label", {}, "lx", lx),
    h("label", {}, "brush m", radius),
    h("button", { title: "Find the pixels that come closest to it", onclick: () => wish() }, "paint it"),
    h("button", { title: "Forget the light wanted", onclick: () => clear() }, "clear"),
  );
  const strip = h(
    "div",
    { class: "world-light", role: "group", "aria-label": "Light in the world" },
    h("span", { class: "segments" }, ...buttons.map(({ button }) => button)),
    share,
    brush,
  );
  scenes.bar.append(strip);
  scenes.body.append(told);

  /** Whether points are asked for. */
  const asks = () => mode() === "find" || mode() === "light";
  const chosen = () => {
    for (const { each, show } of buttons) show(each === mode());
    share.hidden = mode() !== "light";
    brush.hidden = mode() !== "lux";
    scenes.body.classList.toggle("paints", store.state.aim !== null);
    if (!asks()) painting.mark(new Map());
    told.textContent = "";
    draw();
  };
  const draw = () => {
    for (const [view, of] of planes) if (!scenes.views.includes(view)) planes.delete(view) && of.forEach((each) => each.dispose());
    scenes.views.forEach((view, run) => {
      let of = planes.get(view);
      if (!of) {
        of = Object.values(rasters).map((each) => new WishPlane(each));
        planes.set(view, of);
        for (const { mesh, raster } of of) (raster.on === "wall" ? view.onWall : view.overlay).add(mesh);
      }
      const shown = store.state.runs[run]?.shown;
      for (const plane of of) {
        plane.mesh.visible = mode() === "lux" && shown !== null && plane.raster === raster();
        if (!shown || !plane.mesh.visible) continue;
        plane.place(plane.raster.on === "wall" ? T_BODY_WALL : view.local(shown.T_world_ground));
        plane.update();
      }
      view.redraw();
    });
  };
  const wish = () => {
    const { on, box_m, rows, cols, lx, painted } = raster();
    const shape = [rows, cols];
    const arrays = new Map([
      ["lx", { shape, values: lx.slice() }],
      ["painted", { shape, values: painted.slice() }],
    ] as const);
    session.send({ type: "wish", on, box_m: [...box_m], over: painting.over }, arrays);
    told.textContent = "looking for the pixels ...";
  };
  const clear = () => {
    raster().clear();
    told.textContent = "";
    draw();
  };

  /** A point of the world is under the brush. */
  const paintAt = (point: Vector) => {
    if (mode() === "lux") {
      const at = onPlane(point);
      const size_m = numberOf(radius, 1);
      const wanted = lx.value === "" ? null : numberOf(lx);
      const from = before ?? at;
      const steps = Math.ceil(Math.hypot(at[0] - from[0], at[1] - from[1]) / (0.5 * size_m)) || 1;
      for (let k = 1; k <= steps; k++) {
        const share = k / steps;
        raster().paint(from[0] + share * (at[0] - from[0]), from[1] + share * (at[1] - from[1]), size_m, wanted);
      }
      before = at;
      draw();
    } else {
      waiting = point;
      turns.ask();
    }
  };
  const turns = new Turns(() => {
    if (!waiting || !asks()) return false;
    session.send({
      type: "place",
      stroke: painting.stroke,
      point_m: waiting,
      value: mode() === "light" ? Math.round(2.55 * numberOf(utilisation)) : null,
      over: painting.over,
    });
    waiting = null;
    return true;
  }, ANSWER_MS);
  const found = ({ modules }: PlaceMessage) => {
    painting.mark(new Map(modules.map(({ module, pixels }) => [module, new Set(pixels)])));
    const names = modules.map(({ module, pixels }) => `${store.state.scenario?.runs[0].modules[module].name} ${pixels.length}`);
    told.textContent = names.length > 0 ? `pixels: ${names.join(", ")}` : "no module lights this place";
  };
  const onPlane = (point: Vector): [number, number] => {
    const { shown } = store.state.runs[0];
    if (!shown) return [0, 0];
    const T = raster().on === "wall" ? worldOf(shown.T_world_body).multiply(T_BODY_WALL) : worldOf(shown.T_world_ground);
    const { x, y } = new Vector3(...point).applyMatrix4(T.invert());
    return [x, y];
  };

  let stroke: SceneView | null = null;
  let before: [number, number] | null = null; // on the plane, of the same stroke
  const under = (event: PointerEvent) => {
    const point = stroke?.pick(event.offsetX, event.offsetY);
    if (point) paintAt(point);
  };
  // Before the canvas, whose orbit camera listens for the same events.
  scenes.body.addEventListener(
    "pointerdown",
    (event) => {
      const view = scenes.views.find(({ canvas }) => canvas === event.target);
      if (!mode() || !view || event.button !== 0 || !hasPen(store.state)) return;
      event.stopImmediatePropagation();
      view.canvas.setPointerCapture(event.pointerId);
      stroke = view;
      before = null;
      painting.stroke++;
      under(event);
    },
    { capture: true },
  );
  scenes.body.addEventListener("pointermove", (event) => stroke && under(event), { capture: true });
  for (const end of ["pointerup", "pointercancel"] as const) scenes.body.addEventListener(end, () => (stroke = null), { capture: true });

  store.on(["light"], ({ light }) => {
    if (!light) return;
    if (light.type === "wish") {
      const { wanted_lx, given_lx, rmse_lx, worst_lx, pixels } = light;
      told.textContent = `${brief(wanted_lx)} lx wanted, ${brief(given_lx)} lx given; whole field off by ${brief(rmse_lx)} lx (RMSE), at most ${brief(worst_lx)} lx; ${pixels} pixels`;
      return;
    }
    turns.answered();
    if (light.type === "error") told.textContent = "";
    else if (asks()) found(light);
  });
  store.on(["scenario", "step_version", "viewpoint"], () => mode() === "lux" && draw());
  store.on(["aim"], chosen);
  return { rasters };
}

function worldOf(T: StepMessage["T_world_body"]): Matrix4 {
  return new Matrix4().fromArray(T).transpose();
}
