// How far each pixel of each module is turned up, and the painting of it.

import { h, toggle } from "../dom.ts";
import { panel } from "../panels.ts";
import { runSwitch } from "../runs.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio } from "../state.ts";
import { type Point, Viewport } from "../viewport.ts";
import { drawModule, Picture } from "./drawing.ts";
import type { Box } from "./layer.ts";
import { type Layout, layout, type Tile } from "./layout.ts";
import { Painting } from "./painting.ts";
import type { Place } from "./raster.ts";
import { paintTools } from "./tools.ts";

export interface MatrixPanel {
  element: HTMLElement;
  painting: Painting;
  /** CSS pixel of the canvas at the centre of a pixel of a module. */
  pixelAt(module: number, row: number, col: number): [number, number];
}

export function matrixPanel(store: Studio, session: Session, toast: (sentence: string) => void): MatrixPanel {
  const { element, bar, body } = panel(store, "matrix", "Matrix");
  const readout = h("output", { class: "readout" });
  const empty = h("p", { class: "empty" }, "No light yet.");
  const scale = h("div", { class: "scale", "aria-hidden": "true" }, ...["0", "25", "100 %"].map((text) => h("span", {}, text)));
  let tiles: Layout = { width: 1, height: 1, tiles: [] };
  let pictures: Picture[] = [];
  let cursor: Point | null = null;

  const run = () => store.state.scenario?.runs[store.state.matrix_run];
  const utilisation = (module: number) => store.state.runs[store.state.matrix_run]?.utilisations.get(module);
  /** Whether the first run's pixels are painted, and so shown with what is not yet light. */
  const paints = () => painter.button.getAttribute("aria-pressed") === "true" && store.state.matrix_run === 0;
  /** Utilisation 0..255 of a pixel as it is shown, where u is what the run gives it. */
  const shown = (module: number): ((u: number, pixel: number) => number) => {
    const layer = painting.layers[module];
    return layer && paints() ? (u, pixel) => layer.over(pixel, u, painting.over) : (u) => u;
  };
  const colour = (module: number, box: Box | undefined) => {
    const picture = pictures[module];
    const u = picture?.of;
    if (!u || !box) return;
    const of = shown(module);
    picture.colour(box, (pixel) => of(u[pixel], pixel));
  };
  const refresh = () => {
    pictures.forEach((picture, module) => {
      const u = utilisation(module);
      if (!u || picture.of === u) return;
      picture.of = u;
      colour(module, painting.layers[module]?.all);
    });
  };
  const colourAll = () => {
    for (const [module, layer] of painting.layers.entries()) colour(module, layer.all);
    view.redraw();
  };
  const painting = new Painting(
    store,
    (message, arrays) => session.send(message, arrays),
    (what, box) => {
      if (typeof what !== "number") tools?.refresh();
      if (what === null) colourAll();
      else if (typeof what === "number") colour(what, box);
      view?.redraw();
    },
  );
  /** The module below a point, and the place in pixels of its matrix, or of that of the module whose stroke it is. */
  const placeOf = (point: Point, of: Tile | undefined = tileAt(point)): [number, Place] | null => {
    const facts = of && run()?.modules[of.module];
    if (!of || !facts) return null;
    const row = ((point.y - of.y) / of.height) * facts.pixel_rows;
    return [of.module, { row, col: ((point.x - of.x) / of.width) * facts.pixel_cols }];
  };
  const tileAt = (point: Point) => tiles.tiles.find(({ x, y, width, height }) => within(point.x - x, width) && within(point.y - y, height));
  const view = new Viewport(
    "Utilisation of the matrix of each module",
    {
      draw(context, scale) {
        refresh();
        const sight: [Point, Point] = [view.at(0, 0), view.at(view.canvas.clientWidth, view.canvas.clientHeight)];
        for (const tile of tiles.tiles) drawTile(context, scale, tile, sight);
        read();
      },
      hover(point) {
        cursor = point;
        read();
      },
      press(point) {
        const found = paints() && hasPen(store.state) ? placeOf(point) : null;
        if (found && painting.tool === "text" && painting.words.trim() === "") tools.askText();
        else if (found) painting.begin(...found);
        return found !== null;
      },
      stroke(point) {
        const found = placeOf(
          point,
          tiles.tiles.find(({ module }) => module === painting.module),
        );
        if (found) painting.move(found[1]);
      },
      release: () => painting.end(),
    },
    200,
  );
  const painter = toggle("paint", "Paint pixels", (on) => {
    painter.show(on);
    tools.element.hidden = !on;
    view.doubleClickFits = !on;
    colourAll();
  });
  const tools = paintTools(store, painting, (module) => utilisation(module)?.map(shown(module)) ?? null, {
    clear: () => session.edit(["lighting.painted=[]"]),
    toast,
  });
  tools.element.hidden = true;

  const drawTile = (context: CanvasRenderingContext2D, scale: number, tile: Tile, sight: [Point, Point]) => {
    const { module } = tile;
    const facts = run()?.modules[module];
    if (!facts) return;
    const frames: [Iterable<number>, string][] = [[painting.marked.get(module) ?? [], "#7fd8b4"]];
    if (painting.module === module && paints()) frames.push([painting.pending ?? [], "#ffd166"]);
    drawModule(context, scale, tile, facts, pictures[module], frames, sight);
  };
  const read = () => {
    readout.textContent = "";
    const [module, place] = (cursor && placeOf(cursor)) ?? [];
    const facts = module !== undefined && run()?.modules[module];
    if (!facts || !place) return;
    const [row, col] = [Math.floor(place.row), Math.floor(place.col)];
    const pixel = row * facts.pixel_cols + col;
    const u = utilisation(module)?.[pixel];
    const percent = u === undefined ? "" : `: ${((100 * shown(module)(u, pixel)) / 255).toFixed(0)} %`;
    readout.textContent = `${facts.name}, row ${row}, column ${col}${percent}`;
  };

  bar.append(scale, runSwitch(store, "matrix_run"), painter.button);
  body.before(tools.element);
  body.append(view.canvas, empty, readout);
  store.on(["scenario", "matrix_run"], () => {
    const modules = run()?.modules ?? [];
    tiles = layout(modules);
    pictures = modules.map((each) => new Picture(each));
    view.setContent(tiles.width, tiles.height);
    view.redraw();
  });
  store.on(["matrix_version", "runs", "matrix_run"], ({ runs, matrix_run }) => {
    empty.hidden = (runs[matrix_run]?.utilisations.size ?? 0) > 0;
    view.redraw();
  });
  store.on(["maximised"], view.redraw);
  const pixelAt = (module: number, row: number, col: number): [number, number] => {
    const { x, y, width, height } = tiles.tiles.find((tile) => tile.module === module) as Tile;
    const { rows, cols } = painting.layers[module];
    return view.of(x + ((col + 0.5) / cols) * width, y + ((row + 0.5) / rows) * height);
  };
  return { element, painting, pixelAt };
}

function within(value: number, size: number): boolean {
  return value >= 0 && value < size;
}
