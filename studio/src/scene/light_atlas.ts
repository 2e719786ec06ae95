// The light textures of all modules in one texture, of which a step replaces only the window that changed.

import { ClampToEdgeWrapping, DataTexture, HalfFloatType, LinearFilter, RedFormat, Vector2, Vector4, type WebGLRenderer } from "three";
import type { Arrays } from "../arrays.ts";
import type { Module, StepMessage } from "../protocol.ts";

const WIDTH = 2048;
const SIGN = 0x8000;

export class LightAtlas {
  readonly texture: DataTexture;
  /** First column, first row, columns and rows of each module. */
  readonly places: readonly Vector4[];
  private readonly texels: Uint16Array;
  private readonly litRows: readonly Uint8Array[];

  constructor(
    private readonly renderer: WebGLRenderer,
    modules: readonly Module[],
  ) {
    const { width, height, places } = packed(modules);
    this.places = places;
    this.litRows = modules.map((module) => new Uint8Array(module.rows));
    this.texels = new Uint16Array(width * height);
    this.texture = new DataTexture(this.texels, width, height, RedFormat, HalfFloatType);
    this.texture.magFilter = this.texture.minFilter = LinearFilter;
    this.texture.wrapS = this.texture.wrapT = ClampToEdgeWrapping;
    this.texture.needsUpdate = true;
    renderer.initTexture(this.texture);
  }

  /** Takes the windows that a step brings. */
  update(step: StepMessage, arrays: Arrays): void {
    this.places.forEach((place, k) => {
      const light = arrays.get(`light.${k}`)?.values;
      const window = step.light_windows[k];
      if (light instanceof Uint16Array && light.length && window) this.replace(k, place, window, light);
    });
  }

  isLit(k: number): boolean {
    return this.litRows[k]?.includes(1) ?? false;
  }

  dispose(): void {
    this.texture.dispose();
  }

  private replace(k: number, place: Vector4, [first, last, left, right]: [number, number, number, number], light: Uint16Array): void {
    const cols = right - left;
    const { width } = this.texture.image;
    for (let i = 0; i < last - first; i++) {
      const part = light.subarray(i * cols, (i + 1) * cols);
      const start = (place.y + first + i) * width + place.x;
      // The whole is kept here for a graphics context that is lost and restored.
      this.texels.set(part, start + left);
      this.litRows[k]![first + i] = part.some(isLit) || this.texels.subarray(start, start + place.z).some(isLit) ? 1 : 0;
    }
    const part = new DataTexture(light, cols, last - first, RedFormat, HalfFloatType);
    this.renderer.copyTextureToTexture(part, this.texture, null, new Vector2(place.x + left, place.y + first));
  }
}

function isLit(half: number): boolean {
  return (half & ~SIGN) !== 0;
}

/** Rectangles side by side in shelves, the highest first. */
function packed(modules: readonly Module[]): { width: number; height: number; places: Vector4[] } {
  const width = Math.max(WIDTH, ...modules.map((module) => module.cols));
  const order = modules.map((_, k) => k).sort((a, b) => modules[b]!.rows - modules[a]!.rows);
  const places: Vector4[] = modules.map(() => new Vector4());
  let [x, y, shelf] = [0, 0, 0];
  for (const k of order) {
    const { rows, cols } = modules[k]!;
    if (x + cols > width) [x, y, shelf] = [0, y + shelf, 0];
    places[k]!.set(x, y, cols, rows);
    x += cols;
    shelf = Math.max(shelf, rows);
  }
  return { width, height: Math.max(y + shelf, 1), places };
}
