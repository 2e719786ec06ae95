// How the utilisations of a module are drawn: as colours, with the borders of pixels where these are large, frames, and its name.

import type { Module } from "../protocol.ts";
import type { Point } from "../viewport.ts";
import type { Box } from "./layer.ts";
import type { Tile } from "./layout.ts";

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

export class Picture {
  readonly canvas: OffscreenCanvas;
  readonly #image: ImageData;
  /** The utilisations that it shows, of which all are coloured. */
  of: Uint8Array | null = null;

  constructor({ pixel_rows, pixel_cols }: Module) {
    this.canvas = new OffscreenCanvas(pixel_cols, pixel_rows);
    this.#image = new ImageData(pixel_cols, pixel_rows);
  }

  /** Colours the pixels of a box by their utilisations 0..255. */
  colour({ top, bottom, left, right }: Box, u: (pixel: number) => number): void {
    const pixels = new Uint32Array(this.#image.data.buffer);
    const { width } = this.#image;
    for (let row = top; row < bottom; row++) {
      for (let k = row * width + left; k < row * width + right; k++) pixels[k] = COLOURS[u(k)];
    }
    const context = this.canvas.getContext("2d") as OffscreenCanvasRenderingContext2D;
    context.putImageData(this.#image, 0, 0, left, top, right - left, bottom - top);
  }
}

/** Draws a module on its tile. frames: numbers of pixels, and the colour around each. sight: corners of what is seen. */
export function drawModule(
  context: CanvasRenderingContext2D,
  scale: number,
  tile: Tile,
  { name, pixel_rows, pixel_cols }: Module,
  { canvas, of }: Picture,
  frames: readonly [Iterable<number>, string][],
  sight: [Point, Point],
): void {
  const { x, y, width, height } = tile;
  context.fillStyle = "#000";
  context.fillRect(x, y, width, height);
  context.imageSmoothingEnabled = (scale * width * (window.devicePixelRatio || 1)) / pixel_cols < 1;
  if (of) context.drawImage(canvas, x, y, width, height);
  const pixel = { width: width / pixel_cols, height: height / pixel_rows };
  if (scale * Math.min(pixel.width, pixel.height) >= GRID_PX) drawGrid(context, scale, tile, pixel, sight);
  for (const [pixels, style] of frames) {
    context.strokeStyle = style;
    context.lineWidth = 1.5 / scale;
    for (const k of pixels) {
      const [row, col] = [Math.floor(k / pixel_cols), k % pixel_cols];
      context.strokeRect(x + col * pixel.width, y + row * pixel.height, pixel.width, pixel.height);
    }
  }
  context.strokeStyle = "#5b6472";
  context.lineWidth = 1 / scale;
  context.strokeRect(x, y, width, height);
  context.font = `${Math.min(LABEL_PX / scale, 80)}px system-ui, sans-serif`;
  context.textBaseline = "bottom";
  context.fillStyle = "#b4bcc8";
  context.fillText(`${name}  ${pixel_rows} x ${pixel_cols}`, x + 4 / scale, y - 2 / scale);
}

/** Borders of the pixels that are in sight. */
function drawGrid(
  context: CanvasRenderingContext2D,
  scale: number,
  tile: Tile,
  pixel: { width: number; height: number },
  [low, high]: [Point, Point],
): void {
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
}
