// Numbers of isolux lines, a few of each level: where a coarse picture of the illuminance that the lines show passes a level.

import { type Camera, FloatType, type Scene, Vector3, type WebGLRenderer, WebGLRenderTarget } from "three";
import { SOLID } from "./bodies.ts";
import { colourOf, ISOLUX_LX } from "./colour_map.ts";
import type { Label } from "./labels.ts";
import type { SharedUniforms } from "./uniforms.ts";

const [COLS, ROWS] = [240, 135];
const MOST = 3; // of a level
const APART = 0.2 * COLS; // numbers of a level
const BESIDE = 0.04 * COLS; // those of others
const STEEPEST = Math.log(1.6); // between neighbours; where it is steeper, at borders of shadows, lines lie too close to be numbered
const CHANNELS = 4; // of a pixel: place in the local frame, lx

interface Crossing {
  level: number;
  at: Vector3;
  col: number;
  row: number;
}

export class IsoluxNumbers {
  private readonly target = new WebGLRenderTarget(COLS, ROWS, { type: FloatType });
  private readonly pixels = new Float32Array(CHANNELS * COLS * ROWS);

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly uniforms: SharedUniforms,
  ) {}

  /** Labels in the local frame of the lines that a camera sees in a scene whose light is prepared. */
  labels(scene: Scene, camera: Camera): Label[] {
    this.look(scene, camera);
    const chosen: Crossing[] = [];
    ISOLUX_LX.forEach((level, number) => {
      const found = this.crossings(level);
      // Levels lie beside each other, so each begins to look somewhere else.
      const first = Math.floor((found.length * (number + 0.5)) / ISOLUX_LX.length);
      const most = chosen.length + MOST;
      for (const each of [...found.slice(first), ...found.slice(0, first)]) {
        if (chosen.length < most && chosen.every((other) => isApart(each, other))) chosen.push(each);
      }
    });
    return chosen.map(({ level, at }) => {
      const [r, g, b] = colourOf(level);
      return { at, text: `${level}`, colour: inkOn(r, g, b), ground: `rgb(${r} ${g} ${b})` };
    });
  }

  dispose(): void {
    this.target.dispose();
  }

  private look(scene: Scene, camera: Camera): void {
    const { renderer, uniforms, target } = this;
    const layers = camera.layers.mask;
    camera.layers.set(SOLID);
    uniforms.numbers.value = true;
    renderer.setClearAlpha(0); // no light where there is nothing
    renderer.setRenderTarget(target);
    renderer.render(scene, camera);
    renderer.readRenderTargetPixels(target, 0, 0, COLS, ROWS, this.pixels);
    renderer.setRenderTarget(null);
    renderer.setClearAlpha(1);
    uniforms.numbers.value = false;
    camera.layers.mask = layers;
  }

  /** Where the logarithm of the illuminance passes that of a level between neighbours on one surface. */
  private crossings(level: number): Crossing[] {
    const found: Crossing[] = [];
    for (let row = 1; row < ROWS - 2; row++) {
      for (let col = 1; col < COLS - 2; col++) {
        const k = row * COLS + col;
        for (const next of [1, COLS]) {
          const [here, there] = [Math.log(this.lx(k) / level), Math.log(this.lx(k + next) / level)];
          if (!(here * there < 0) || Math.abs(here - there) > STEEPEST) continue;
          const [before, a, b, after] = [this.at(k - next), this.at(k), this.at(k + next), this.at(k + 2 * next)];
          if (a.distanceTo(b) > 2 * Math.min(before.distanceTo(a), b.distanceTo(after))) continue; // of two surfaces
          const share = here / (here - there);
          found.push({ level, at: a.lerp(b, share), col: col + (next === 1 ? share : 0), row: row + (next === 1 ? 0 : share) });
        }
      }
    }
    return found;
  }

  private lx(k: number): number {
    return this.pixels[CHANNELS * k + 3]!;
  }

  private at(k: number): Vector3 {
    return new Vector3().fromArray(this.pixels, CHANNELS * k);
  }
}

function isApart(a: Crossing, b: Crossing): boolean {
  return Math.hypot(a.col - b.col, a.row - b.row) > (a.level === b.level ? APART : BESIDE);
}

/** Black or white, whichever has more contrast with a colour in sRGB, 0..255. */
function inkOn(...ground: [number, number, number]): string {
  const [r, g, b] = ground.map((each) => ((each / 255 + 0.055) / 1.055) ** 2.4) as [number, number, number];
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.179 ? "#000" : "#fff";
}
