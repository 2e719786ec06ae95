// The studio's page: one store, one session with the server, and panels that show the one and ask the other.

import { cameraPanel } from "./camera/panel.ts";
import { curvesPanel } from "./curves/panel.ts";
import { helpDialog, summaryDialog } from "./dialogs.ts";
import { h } from "./dom.ts";
import { driveControls } from "./drive/index.ts";
import { bindKeys } from "./keys.ts";
import { layout } from "./layout.ts";
import type { Painting } from "./matrix/painting.ts";
import { type MatrixPanel, matrixPanel } from "./matrix/panel.ts";
import { measuring } from "./measure/index.ts";
import { keepOff } from "./model/entries.ts";
import { keysPanel } from "./model/panel.ts";
import { notices } from "./notices.ts";
import { placeThings } from "./place/index.ts";
import type { Placing } from "./place/placing.ts";
import type { SceneView } from "./scene/index.ts";
import { beamControls } from "./scenes/beam.ts";
import { ScenesPanel } from "./scenes/panel.ts";
import { Session } from "./session.ts";
import { newStore, type Studio } from "./state.ts";
import { Toasts } from "./toast.ts";
import { toolbar } from "./toolbar.ts";
import { worldLight } from "./world/light.ts";
import type { Raster, Surface } from "./world/raster.ts";

declare global {
  interface Window {
    /** For tests: the page's state, the scene of each run, what is chosen there, what is painted, where its pixels are, and the light that is wanted. */
    luxloop: {
      store: Studio;
      readonly scenes: SceneView[];
      placing: Placing | null;
      painting: Painting;
      pixelAt: MatrixPanel["pixelAt"];
      wanted: Readonly<Record<Surface, Raster>>;
    };
  }
}

const store = newStore();
keepOff(store);
const toasts = new Toasts();
const scenes = new ScenesPanel(store);
const scheme = location.protocol === "https:" ? "wss" : "ws";
const address = { url: `${scheme}://${location.host}/socket`, token: decodeURIComponent(location.hash.slice(1)) };
const session = new Session(address, store, scenes, toasts.show);
const help = helpDialog();
const summary = summaryDialog(store, session);
const flipKeys = () => store.set({ keys_open: !store.state.keys_open });
const tools = toolbar(store, session, { help: help.open, summary: summary.open, keys: flipKeys });
beamControls(store, session, scenes.bar, scenes.body);
driveControls(store, session, scenes);
const placing = placeThings(store, session, scenes, toasts.show);

const matrix = matrixPanel(store, session, toasts.show);
const light = worldLight(store, session, scenes, matrix.painting);
const measures = measuring(store, session, scenes, toasts.show);
const panels = [scenes.element, cameraPanel(store, measures), matrix.element, curvesPanel(store, session)] as const;
const [scene, camera, pixels, curves] = panels;
const borders = layout(store, panels);
const main = h("main", {}, measures.profile, scene, borders.columns, camera, borders.pictures, pixels, borders.rows, curves);
const top = h("header", { class: "top" }, tools.element, notices(store));
document.body.append(
  top,
  main,
  borders.drawer,
  keysPanel(store, session, toasts.show),
  measures.element,
  toasts.element,
  help.element,
  summary.element,
);
store.on(["maximised"], ({ maximised }) => main.classList.toggle("maximised", maximised !== null));
store.on(["keys_open"], ({ keys_open }) => document.body.classList.toggle("drawn", keys_open));
store.on(["scenario"], toasts.clear);
store.on(["scenario"], ({ scenario }) => {
  document.title = scenario ? `${scenario.name} - luxloop studio` : "luxloop studio";
});
bindKeys(store, { ...tools, help: help.open, keys: flipKeys });
addEventListener("hashchange", () => location.reload());

window.luxloop = {
  store,
  painting: matrix.painting,
  pixelAt: matrix.pixelAt,
  wanted: light.rasters,
  placing,
  get scenes() {
    return scenes.views;
  },
};
