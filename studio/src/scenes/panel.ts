// The scene of each run, all seen from the same place in the same light, and the controls of that.

import type { Arrays } from "../arrays.ts";
import { h, select, toggle } from "../dom.ts";
import { EXPOSURE_EV, VIEWPOINTS } from "../keys.ts";
import { panel } from "../panels.ts";
import type { MeshesMessage, ScenarioMessage, StepMessage } from "../protocol.ts";
import { type Orbit, type SceneOptions, SceneView } from "../scene/index.ts";
import type { SceneSink } from "../session.ts";
import type { Studio, Viewpoint } from "../state.ts";

interface Cell {
  element: HTMLElement;
  label: HTMLElement;
  view: SceneView | null;
}

export class ScenesPanel implements SceneSink {
  readonly element: HTMLElement;
  readonly bar: HTMLElement;
  readonly body: HTMLElement;
  readonly #cells: Cell[] = [];
  #orbit: Orbit | null = null;
  readonly #room = h("div", { class: "scenes" });

  constructor(private readonly store: Studio) {
    const { element, bar, body } = panel(store, "scene", "Scene");
    this.element = element;
    this.bar = bar;
    this.body = body;
    body.append(this.#room);
    bar.append(...lightControls(store));
    this.#fit(1);
    store.on(["exposure_ev", "style", "isolux", "fog", "frusta"], (state) => this.#each((view) => applyOptions(view, state)));
    store.on(["viewpoint"], ({ viewpoint }) => this.#each((view) => view.setViewpoint(viewpoint)));
    store.on(["beams", "viewpoint", "rule", "side"], (state) => {
      this.#cells.forEach(({ view }, run) => {
        const beam = state.viewpoint === "wall" ? state.beams[run] : null;
        view?.setBeam(beam && beam.rule === state.rule ? beam.points : [], state.side);
      });
    });
  }

  /** The views that there are, one a run. */
  get views(): SceneView[] {
    return this.#cells.flatMap(({ view }) => view ?? []);
  }

  begin({ runs }: ScenarioMessage): void {
    this.#fit(runs.length);
    this.#cells.forEach(({ view, label }, run) => {
      view?.setRun(runs[run]);
      label.textContent = `run ${run + 1}: ${runs[run].label}`;
      label.hidden = runs.length < 2;
    });
  }

  edited(run: number): void {
    this.#cells[run]?.view?.edited();
  }

  meshes(message: MeshesMessage, arrays: Arrays): void {
    this.#cells[message.run]?.view?.addMeshes(message, arrays);
  }

  step(message: StepMessage, arrays: Arrays): void {
    this.#cells[message.run]?.view?.show(message, arrays);
  }

  #each(call: (view: SceneView) => void): void {
    for (const view of this.views) call(view);
  }

  #fit(count: number): void {
    while (this.#cells.length > count) {
      const cell = this.#cells.pop();
      cell?.view?.dispose();
      cell?.element.remove();
    }
    while (this.#cells.length < count) this.#cells.push(this.#cell());
    for (const view of this.views) view.onMove = (orbit) => this.#follow(view, orbit);
  }

  /** Look at all runs from where one was moved to. */
  #follow(moved: SceneView, orbit: Orbit): void {
    this.#orbit = orbit;
    for (const view of this.views) if (view !== moved) view.setOrbit(orbit);
  }

  #cell(): Cell {
    const label = h("p", { class: "scene-label" });
    label.hidden = true;
    const container = h("div", { class: "scene-view" });
    const element = h("div", { class: "scene-cell" }, container, label);
    this.#room.append(element);
    let view: SceneView | null = null;
    try {
      view = new SceneView(container);
      applyOptions(view, this.store.state);
      view.setViewpoint(this.store.state.viewpoint);
      if (this.#orbit) view.setOrbit(this.#orbit);
    } catch (error) {
      console.error(error);
      container.append(h("p", { class: "empty" }, `The scene cannot be drawn: ${error instanceof Error ? error.message : error}`));
    }
    return { element, label, view };
  }
}

function applyOptions(view: SceneView, { exposure_ev, style, isolux, fog, frusta }: SceneOptions): void {
  view.setOptions({ exposure_ev, style, isolux, fog, frusta });
}

function lightControls(store: Studio): HTMLElement[] {
  const viewpoint = select("Viewpoint (1 to 5)", VIEWPOINTS, (value) => store.set({ viewpoint: value as Viewpoint }));
  const { least, most } = EXPOSURE_EV;
  const exposure = h("input", { type: "range", min: least, max: most, step: 0.1, "aria-label": "Exposure in EV", class: "exposure" });
  const number = h("output", { class: "ev" });
  exposure.addEventListener("input", () => store.set({ exposure_ev: exposure.valueAsNumber }));
  exposure.addEventListener("dblclick", () => store.set({ exposure_ev: 0 }));
  const style = select(
    "What colours show",
    [
      ["luminance", "luminance"],
      ["lux", "illuminance"],
    ],
    (value) => store.set({ style: value === "lux" ? "lux" : "luminance" }),
  );
  const flags = (
    [
      ["isolux", "Lines of equal illuminance, with their numbers in lx"],
      ["fog", "Light that haze scatters"],
      ["frusta", "Fields of the lamps' modules and of the camera"],
    ] as const
  ).map(([key, title]) => ({ key, ...toggle(key, title, (on) => store.set({ [key]: on })) }));
  store.on(["viewpoint", "exposure_ev", "style", "isolux", "fog", "frusta"], (state) => {
    viewpoint.value = state.viewpoint;
    exposure.value = String(state.exposure_ev);
    number.textContent = `${state.exposure_ev > 0 ? "+" : ""}${state.exposure_ev.toFixed(1)} EV`;
    exposure.setAttribute("aria-valuetext", number.textContent);
    style.value = state.style;
    for (const { key, show } of flags) show(state[key]);
  });
  const slider = h("label", { class: "slider", title: "Exposure ([ and ])" }, h("span", { class: "wide" }, "exposure"), exposure, number);
  return [viewpoint, slider, style, ...flags.map(({ button }) => button)];
}
