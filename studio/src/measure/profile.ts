// A line across road or wall: the light along it, as a chart over metres or degrees and as a CSV file, renewed with each step.

import { BufferGeometry, Line, LineBasicMaterial, Matrix4, Vector3 } from "three";
import uPlot from "uplot";
import type { Vector } from "../arrays.ts";
import { csv, download, h, select, signButton } from "../dom.ts";
import type { Reading } from "../protocol.ts";
import { matrix } from "../scene/frames.ts";
import type { SceneView } from "../scene/index.ts";
import type { Studio } from "../state.ts";
import type { Meter, Sight } from "./meter.ts";

const POINTS = 201;
const COLOUR = "#f0e442";
const INK = "#b4bcc8";
const QUANTITIES = {
  lx: "E, surface (lx)",
  vertical_lx: "Ev, upright (lx)",
  cd_m2: "L (cd/m²)",
  cd: "I (cd)",
} as const;
type Quantity = keyof typeof QUANTITIES;

export interface Along {
  view: SceneView;
  run: number;
  on: "scene" | "wall";
  side: Sight["side"];
  /** Eye and ends in the ground's frame; on the wall in that of the car's body. */
  eye: Vector3;
  ends: [Vector3, Vector3];
}

export class Profile {
  readonly element: HTMLElement;
  #along: Along | null = null;
  #readings: Reading[] = [];
  #quantity: Quantity = "lx";
  readonly #line = new Line(new BufferGeometry(), new LineBasicMaterial({ color: COLOUR, depthTest: false }));
  readonly #room = h("div", { class: "plot" });
  #plot: uPlot | null = null;

  constructor(
    private readonly store: Studio,
    private readonly meter: Meter,
  ) {
    this.#line.renderOrder = 4;
    this.#line.frustumCulled = false;
    const quantity = select("What the profile shows", Object.entries(QUANTITIES), (value) => {
      this.#quantity = value as Quantity;
      this.#draw();
    });
    const save = h("button", { title: "Download the profile as CSV", onclick: () => this.#save() }, "CSV");
    const close = signButton("close", "Remove the line", () => this.show(null));
    this.element = h("figure", { class: "profile" }, h("figcaption", {}, "Profile", quantity, save, close), this.#room);
    this.element.hidden = true;
    new ResizeObserver(() => this.#draw()).observe(this.#room);
    store.on(["step_version"], () => this.#ask());
    store.on(["scenario", "viewpoint"], () => this.show(null));
  }

  /** Draw another line, null: none. */
  show(along: Along | null): void {
    this.#along?.view.redraw();
    this.#line.removeFromParent();
    this.#along = along;
    this.element.hidden = true;
    if (!along) return;
    (along.on === "wall" ? along.view.onWall : along.view.overlay).add(this.#line);
    this.#place();
    this.#ask();
  }

  /** Pose of the line's frame in the world. */
  #frame(): Matrix4 | null {
    const shown = this.#along && this.store.state.runs[this.#along.run]?.shown;
    return shown ? matrix(this.#along?.on === "wall" ? shown.T_world_body : shown.T_world_ground) : null;
  }

  /** The line in its view, whose wall has the frame of the body. */
  #place(): void {
    const [along, T] = [this.#along, this.#frame()];
    if (!along || !T) return;
    const T_view = along.on === "wall" ? new Matrix4() : along.view.local(T.clone().transpose().toArray());
    this.#line.geometry.dispose();
    this.#line.geometry = new BufferGeometry().setFromPoints(along.ends.map((end) => end.clone().applyMatrix4(T_view)));
    along.view.redraw();
  }

  #ask(): void {
    if (!this.#along) return;
    this.#place();
    const asked = this.#along;
    this.meter.ask(
      "profile",
      () => this.#sight(),
      (readings) => {
        if (this.#along !== asked) return;
        this.#readings = readings.filter((each) => each !== null);
        this.element.hidden = this.#readings.length < 2;
        this.#draw();
      },
    );
  }

  #sight(): Sight | null {
    const [along, T] = [this.#along, this.#frame()];
    if (!along || !T) return null;
    const [from, to] = along.ends;
    const world = (point: Vector3): Vector => point.clone().applyMatrix4(T).toArray();
    const through_m = Array.from({ length: POINTS }, (_, k) => world(from.clone().lerp(to, k / (POINTS - 1))));
    return { run: along.run, on: along.on, side: along.side, eye_m: world(along.eye), through_m };
  }

  /** Places of the readings on the horizontal axis: degrees on the wall, along which the line goes most, else metres from its beginning. */
  #axis(): { label: string; places: number[] } {
    const [first, last] = [this.#readings[0]!, this.#readings.at(-1)!];
    if (this.#along?.on === "wall") {
      const key = Math.abs(last.h_deg - first.h_deg) >= Math.abs(last.v_deg - first.v_deg) ? "h_deg" : "v_deg";
      return { label: key === "h_deg" ? "H (°)" : "V (°)", places: this.#readings.map((each) => each[key]) };
    }
    const start = new Vector3(...first.ground_m);
    return { label: "m", places: this.#readings.map(({ ground_m }) => start.distanceTo(new Vector3(...ground_m))) };
  }

  #draw(): void {
    if (this.element.hidden) return;
    const { label, places } = this.#axis();
    const rows = places.map((place, k) => [place, this.#readings[k]![this.#quantity]] as const).sort(([a], [b]) => a - b);
    const axis = { stroke: INK, grid: { stroke: "#2c323b", width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    this.#plot?.destroy();
    this.#plot = new uPlot(
      {
        width: this.#room.clientWidth,
        height: this.#room.clientHeight,
        legend: { show: false },
        scales: { x: { time: false } },
        axes: [
          { ...axis, label, labelSize: 14, labelFont: axis.font, size: 22 },
          { ...axis, size: 46 },
        ],
        series: [{}, { stroke: COLOUR, width: 1.5 }],
      },
      [rows.map(([place]) => place), rows.map(([, value]) => value)],
      this.#room,
    );
  }

  #save(): void {
    const { label, places } = this.#axis();
    const name = { m: "along_m", "H (°)": "along_h_deg", "V (°)": "along_v_deg" }[label] ?? label;
    download("profile.csv", csvOf(this.#readings, { name, places }));
  }
}

const COLUMNS = ["surface", "x_m", "y_m", "z_m", "h_deg", "v_deg", "distance_m", "lx", "vertical_lx", "cd_m2", "cd"] as const;

/** Readings as lines of a CSV file, behind their places along a line. */
export function csvOf(readings: readonly Reading[], along?: { name: string; places: readonly number[] }): Blob {
  const lines = readings.map(({ surface, ground_m, h_deg, v_deg, distance_m, lx, vertical_lx, cd_m2, cd }, k) => [
    ...(along ? [along.places[k]!] : []),
    ...[surface, ...ground_m, h_deg, v_deg, distance_m, lx, vertical_lx, cd_m2 ?? "", cd],
  ]);
  return csv([...(along ? [along.name] : []), ...COLUMNS], lines);
}
