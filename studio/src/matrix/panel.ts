// How far each pixel of each module is turned up.

import { h, toggle } from "../dom.ts";
import { panel } from "../panels.ts";
import { runSwitch } from "../runs.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio } from "../state.ts";
import { type Point, Viewport } from "../viewport.ts";
import type { Box } from "./layer.ts";
import { type Layout, layout, type Tile } from "./layout.ts";
import { Painting } from "./painting.ts";
import type { Place } from "./raster.ts";
import { paintTools } from "./tools.ts";

const LABEL_PX = 11;
const GRID_PX = 10; // width of a pixel from which its border is drawn
const STOPS: [number, number, number, number][] = [
  [0, 0, 0, 0],
  [0.3, 92, 47, 12],
  [0.7, 240, 166, 58],
  [1, 255, 251, 235],
];

/** Colours of utilisations 0..255 as little-endian RGBA, by their root so that dimmed light shows; they grow lighter without a break. */
const COLOURS = Uint32Array.from({ length: 256 }, (_, code) => {
  const share = Math.sqrt(code / 255);
  const next = Math.max(
    1,
    STOPS.findIndex(([at]) => at >= share),
  );
  const [low, high] = [STOPS[next - 1], STOPS[next]];
  const between = (share - low[0]) / (high[0] - low[0]);
  const [r, g, b] = [1, 2, 3].map((channel) => Math.round(low[channel] + between * (high[channel] - low[channel])));
  return (0xff000000 | (b << 16) | (g << 8) | r) >>> 0;
});

interface Painted {
  canvas: OffscreenCanvas;
  image: ImageData;
  of: Uint8Array | null;
}

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
  let pictures: Painted[] = [];
  let cursor: { x: number; y: number } | null = null;

  const run = () => store.state.scenario?.runs[store.state.matrix_run];
  const utilisation = (module: number) => store.state.runs[store.state.matrix_run]?.utilisations.get(module);
  /** Whether the first run's pixels are painted, and so shown with what is not yet light. */
  const paints = () => painter.button.getAttribute("aria-pressed") === "true" && store.state.matrix_run === 0;
  const shownOf = (module: number) => {
    const u = utilisation(module);
    const layer = painting.layers[module];
    return u && layer && paints() ? u.map((value, pixel) => layer.over(pixel, value, painting.over)) : (u ?? null);
  };
  const refresh = () => {
    pictures.forEach((picture, module) => {
      const u = utilisation(module);
      if (!u || picture.of === u) return;
      picture.of = u;
      colour(module, painting.layers[module]?.all);
    });
  };
  const colour = (module: number, box: Box | undefined) => {
    const { image, canvas, of: u } = pictures[module];
    const layer = painting.layers[module];
    if (!u || !box) return;
    const pixels = new Uint32Array(image.data.buffer);
    const plain = !paints();
    for (let row = box.top; row < box.bottom; row++) {
      for (let k = row * image.width + box.left; k < row * image.width + box.right; k++) {
        pixels[k] = COLOURS[plain ? u[k] : layer.over(k, u[k], painting.over)];
      }
    }
    const context = canvas.getContext("2d") as OffscreenCanvasRenderingContext2D;
    context.putImageData(image, 0, 0, box.left, box.top, box.right - box.left, box.bottom - box.top);
  };
  const colourAll = () => {
    for (const [module, layer] of painting.layers.entries()) if (pictures[module]) colour(module, layer.all);
    view.redraw();
  };
  const painting = new Painting(
    store,
    (message, arrays) => session.send(message, arrays),
    (what, box) => {
      if (typeof what !== "number") tools?.refresh();
      if (what === null) colourAll();
      else if (typeof what === "number" && box && pictures[what]) colour(what, box);
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
        for (const tile of tiles.tiles) drawTile(context, scale, tile);
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
  const tools = paintTools(store, painting, shownOf, {
    clear: () => session.edit(["lighting.painted=[]"]),
    toast,
  });
  tools.element.hidden = true;

  const drawTile = (context: CanvasRenderingContext2D, scale: number, { module, x, y, width, height }: Tile) => {
    const { canvas, of } = pictures[module];
    const facts = run()?.modules[module];
    if (!facts) return;
    context.fillStyle = "#000";
    context.fillRect(x, y, width, height);
    context.imageSmoothingEnabled = (scale * width * (window.devicePixelRatio || 1)) / facts.pixel_cols < 1;
    if (of) context.drawImage(canvas, x, y, width, height);
    const pixel = { width: width / facts.pixel_cols, height: height / facts.pixel_rows };
    if (scale * Math.min(pixel.width, pixel.height) >= GRID_PX) drawGrid(context, scale, { x, y, width, height }, pixel);
    const framed: [Iterable<number>, string][] = [[painting.marked.get(module) ?? [], "#7fd8b4"]];
    if (painting.module === module && paints()) framed.push([painting.pending ?? [], "#ffd166"]);
    for (const [pixels, style] of framed) {
      context.strokeStyle = style;
      context.lineWidth = 1.5 / scale;
      for (const k of pixels) {
        const [row, col] = [Math.floor(k / facts.pixel_cols), k % facts.pixel_cols];
        context.strokeRect(x + col * pixel.width, y + row * pixel.height, pixel.width, pixel.height);
      }
    }
    context.strokeStyle = "#5b6472";
    context.lineWidth = 1 / scale;
    context.strokeRect(x, y, width, height);
    const font_px = Math.min(LABEL_PX / scale, 80);
    context.font = `${font_px}px system-ui, sans-serif`;
    context.textBaseline = "bottom";
    context.fillStyle = "#b4bcc8";
    context.fillText(`${facts.name}  ${facts.pixel_rows} x ${facts.pixel_cols}`, x + 4 / scale, y - 2 / scale);
  };
  /** Borders of the pixels that are in sight. */
  const drawGrid = (
    context: CanvasRenderingContext2D,
    scale: number,
    tile: Omit<Tile, "module">,
    pixel: { width: number; height: number },
  ) => {
    const [low, high] = [view.at(0, 0), view.at(view.canvas.clientWidth, view.canvas.clientHeight)];
    const [left, right] = [Math.max(tile.x, low.x), Math.min(tile.x + tile.width, high.x)];
    const [top, bottom] = [Math.max(tile.y, low.y), Math.min(tile.y + tile.height, high.y)];
    context.beginPath();
    for (let x = tile.x + pixel.width * Math.ceil((left - tile.x) / pixel.width); x <= right; x += pixel.width) {
      context.moveTo(x, top);
      context.lineTo(x, bottom);
    }
    for (let y = tile.y + pixel.height * Math.ceil((top - tile.y) / pixel.height); y <= bottom; y += pixel.height) {
      context.moveTo(left, y);
      context.lineTo(right, y);
    }
    context.strokeStyle = "#6b7482";
    context.lineWidth = 0.5 / scale;
    context.stroke();
  };
  const shownAt = (module: number, pixel: number) => {
    const u = utilisation(module)?.[pixel];
    return u === undefined || !paints() ? u : painting.layers[module].over(pixel, u, painting.over);
  };
  const read = () => {
    const tile = cursor && tileAt(cursor);
    const facts = tile && run()?.modules[tile.module];
    if (!cursor || !tile || !facts) {
      readout.textContent = "";
      return;
    }
    const row = Math.min(facts.pixel_rows - 1, Math.floor(((cursor.y - tile.y) / tile.height) * facts.pixel_rows));
    const col = Math.min(facts.pixel_cols - 1, Math.floor(((cursor.x - tile.x) / tile.width) * facts.pixel_cols));
    const u = shownAt(tile.module, row * facts.pixel_cols + col);
    readout.textContent = `${facts.name}, row ${row}, column ${col}${u === undefined ? "" : `: ${((100 * u) / 255).toFixed(0)} %`}`;
  };

  bar.append(scale, runSwitch(store, "matrix_run"), painter.button);
  body.before(tools.element);
  body.append(view.canvas, empty, readout);
  store.on(["scenario", "matrix_run"], () => {
    const modules = run()?.modules ?? [];
    tiles = layout(modules);
    pictures = modules.map(({ pixel_rows, pixel_cols }) => ({
      canvas: new OffscreenCanvas(pixel_cols, pixel_rows),
      image: new ImageData(pixel_cols, pixel_rows),
      of: null,
    }));
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
