// Painting: the layers of all modules, what the tools do to them, and what of it is on its way to the server.

import type { Arrays } from "../arrays.ts";
import type { Module, PaintRequest } from "../protocol.ts";
import type { Studio } from "../state.ts";
import { Turns } from "../turns.ts";
import { type Pixels, readPng } from "./files.ts";
import { type Box, both, Layer } from "./layer.ts";
import { line, type Place, region, text } from "./raster.ts";

export const TOOLS = ["brush", "eraser", "line", "fill", "text"] as const;
export type Tool = (typeof TOOLS)[number];

const QUIET_MS = 100; // between the last edit and taking what the server has: a stroke is many of them
const ANSWER_MS = 3000; // after which the next stroke is sent without the last one's answer

interface PaintedParams {
  module: string;
  png: string;
  over: boolean;
}

export class Painting {
  tool: Tool = "brush";
  /** In pixels; of text, the height of its letters. */
  thickness = 1;
  /** 0..255. */
  value = 255;
  words = "";
  over = true;
  /** The number of the stroke that was begun last, which is taken back as one; other pages have other numbers. */
  stroke = 1 + Math.floor(Math.random() * 2 ** 30);
  /** The module that was painted or pointed at last. */
  module = 0;
  layers: Layer[] = [];
  /** Pixels that are shown by a frame, by module. */
  marked = new Map<number, Set<number>>();
  readonly #dirty = new Map<number, Box>();
  readonly #turns = new Turns(() => this.#send(), ANSWER_MS);
  #stroke: { module: number; from: Place; to: Place } | null = null;
  #shown: unknown = null;
  #due: ReturnType<typeof setTimeout> | undefined;
  /** Pictures that came last, by their texts: most edits leave most of them. */
  #pictures = new Map<string, Promise<Pixels>>();

  /** changed: a module's layer has changed within a box, the choice of tools alone, or all where it is null. */
  constructor(
    store: Studio,
    private readonly send: (message: PaintRequest, arrays: Arrays) => void,
    private readonly changed: (what: number | "tools" | null, box?: Box) => void,
  ) {
    store.on(["scenario"], ({ scenario }) => {
      this.layers = (scenario?.runs[0].modules ?? []).map(({ pixel_rows, pixel_cols }) => new Layer(pixel_rows, pixel_cols));
      this.module = Math.min(this.module, Math.max(0, this.layers.length - 1));
      this.#dirty.clear();
      this.#stroke = null;
      this.marked.clear();
      this.#turns.answered();
    });
    store.on(["scenario", "model"], ({ scenario, model }) => {
      clearTimeout(this.#due);
      if (scenario) this.#due = setTimeout(() => void this.#show(scenario.runs[0].modules, model), QUIET_MS);
    });
    store.on(["answered"], () => this.#turns.answered());
  }

  /** The line from which on a stroke is drawn, which is not painted yet. */
  get pending(): Set<number> | null {
    if (this.tool !== "line" || !this.#stroke) return null;
    return line(this.layers[this.#stroke.module], this.#stroke.from, this.#stroke.to, this.thickness);
  }

  begin(module: number, at: Place): void {
    this.stroke++;
    const layer = this.layers[module];
    this.module = module;
    const seed = Math.floor(at.row) * layer.cols + Math.floor(at.col);
    if (this.tool === "fill") {
      const alike = (one: number, other: number) => layer.painted[one] === layer.painted[other] && layer.value[one] === layer.value[other];
      this.paint(module, region(layer, seed, alike));
    } else if (this.tool === "text") {
      this.paint(module, text(layer, at, this.words, Math.max(3, this.thickness)));
    } else {
      this.#stroke = { module, from: at, to: at };
      this.move(at);
    }
    this.changed("tools");
  }

  /** A stroke goes on, beyond the borders of its module as well. */
  move(at: Place): void {
    if (!this.#stroke) return;
    const { module, from } = this.#stroke;
    this.#stroke = { module, from: this.tool === "line" ? from : at, to: at };
    if (this.tool === "line") this.changed(module);
    else this.paint(module, line(this.layers[module], from, at, this.thickness), this.tool === "eraser" ? null : this.value);
  }

  end(): void {
    const pending = this.pending;
    const stroke = this.#stroke;
    this.#stroke = null;
    if (stroke && pending) this.paint(stroke.module, pending);
  }

  paint(module: number, pixels: Iterable<number>, value: number | null = this.value): void {
    this.#touch(module, this.layers[module].paint(pixels, value));
  }

  /** The content of a file on a module. Throws an Error where it has not the module's size. */
  take(module: number, name: string, { rows, cols, value, painted }: Pixels, file: string): void {
    const layer = this.layers[module];
    if (rows !== layer.rows || cols !== layer.cols) {
      throw new Error(`${file}: has ${rows} x ${cols} pixels, but ${name} has ${layer.rows} x ${layer.cols}; bring it to this size`);
    }
    this.stroke++;
    layer.replace(value, painted);
    this.#touch(module, layer.all);
  }

  /** Paint over what the functions give, or in its place, in all modules. */
  setOver(over: boolean): void {
    this.stroke++;
    this.over = over;
    for (const [module, layer] of this.layers.entries()) this.#touch(module, { ...layer.all, bottom: 1, right: 1 });
    this.changed(null);
  }

  /** Frame pixels, by module. */
  mark(pixels: Map<number, Set<number>>): void {
    this.marked = pixels;
    this.changed("tools");
  }

  #touch(module: number, box: Box | null): void {
    if (!box) return;
    const dirty = both(this.#dirty.get(module) ?? null, box);
    if (dirty) this.#dirty.set(module, dirty);
    this.changed(module, box);
    this.#turns.ask();
  }

  #send(): boolean {
    const [next] = this.#dirty;
    if (!next) return false;
    const [module, box] = next;
    this.#dirty.delete(module);
    const layer = this.layers[module];
    const shape = [box.bottom - box.top, box.right - box.left];
    const arrays = new Map((["value", "painted"] as const).map((name) => [name, { shape, values: layer.cut(layer[name], box) }] as const));
    this.send({ type: "paint", stroke: this.stroke, module, box: [box.top, box.bottom, box.left, box.right], over: this.over }, arrays);
    return true;
  }

  /** Take what the server has, unless something is painted that it has not yet. */
  async #show(modules: readonly Module[], model: unknown): Promise<void> {
    this.#shown = model;
    const params = (model as { lighting?: { painted?: PaintedParams[] } } | null)?.lighting?.painted ?? [];
    this.#pictures = new Map(params.map(({ png }) => [png, this.#pictures.get(png) ?? decoded(png)]));
    const pictures = await Promise.all(params.map(({ png }) => this.#pictures.get(png)));
    if (this.#shown !== model || this.#stroke || this.#dirty.size > 0 || this.#turns.waits) return;
    const over = params.every((each) => each.over);
    const switched = over !== this.over;
    this.over = over;
    for (const [module, layer] of this.layers.entries()) {
      const picture = pictures[params.findIndex((each) => each.module === modules[module].name)];
      if (picture && (picture.rows !== layer.rows || picture.cols !== layer.cols)) continue;
      const [value, painted] = [
        picture?.value ?? new Uint8Array(layer.value.length),
        picture?.painted ?? new Uint8Array(layer.value.length),
      ];
      if (same(value, layer.value) && same(painted, layer.painted)) continue;
      layer.replace(value, painted);
      this.changed(module, layer.all);
    }
    if (switched) this.changed(null);
  }
}

function decoded(png: string): Promise<Pixels> {
  const bytes = Uint8Array.from(atob(png), (letter) => letter.charCodeAt(0));
  return readPng(new Blob([bytes], { type: "image/png" }), "lighting.painted");
}

function same(one: Uint8Array, other: Uint8Array): boolean {
  return one.every((value, k) => value === other[k]);
}
