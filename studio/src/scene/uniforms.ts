// Uniforms that all materials of a view share, and the materials that are made of them.

import {
  type DataTexture,
  DoubleSide,
  FrontSide,
  GLSL3,
  type IUniform,
  Matrix4,
  RawShaderMaterial,
  type Side,
  type Texture,
  Vector2,
  Vector3,
  Vector4,
} from "three";
import { DEPTH_FRAGMENT, DEPTH_VERTEX, MOST_LAMPS, MOST_MAPS, MOST_MODULES, SURFACE_FRAGMENT, SURFACE_VERTEX } from "./shaders.ts";

function many<T>(count: number, make: () => T): T[] {
  return Array.from({ length: count }, make);
}

/** Visibility of the fog that the option `fog` shows: scattering and extinction -ln 0.05 / visibility (Koschmieder). */
const VISIBILITY_M = 150;
export const FOG_PER_M = -Math.log(0.05) / VISIBILITY_M;

export function sharedUniforms() {
  return {
    module_count: { value: 0 },
    module_pose: { value: many(MOST_MODULES, () => new Matrix4()) },
    module_position: { value: many(MOST_MODULES, () => new Vector3()) },
    module_borders: { value: many(MOST_MODULES, () => new Vector4()) },
    module_place: { value: many(MOST_MODULES, () => new Vector4()) },
    module_light: { value: many(MOST_MODULES, () => new Vector2()) },
    light_atlas: { value: null as DataTexture | null },
    extinction_per_m: { value: 0 },
    shadows: { value: true },
    map_pose: { value: many(MOST_MAPS, () => new Matrix4()) },
    map_borders: { value: many(MOST_MAPS, () => new Vector4()) },
    map_place: { value: many(MOST_MAPS, () => new Vector4()) },
    map_range: { value: new Vector2() },
    shadow_maps: { value: null as Texture | null },
    ambient_lx: { value: 0 },
    street_count: { value: 0 },
    street_lamps: { value: many(MOST_LAMPS, () => new Vector4()) },
    spot_count: { value: 0 },
    spot_position: { value: many(MOST_LAMPS, () => new Vector4()) },
    spot_axis: { value: many(MOST_LAMPS, () => new Vector3()) },
    spot_width: { value: many(MOST_LAMPS, () => new Vector2(1, 1)) },
    luminance_gain: { value: 1 },
    lux: { value: false },
    lines: { value: false },
    numbers: { value: false },
    ground_up: { value: new Vector3(0, 0, 1) },
    fog: { value: false },
    eye_extinction_per_m: { value: 0 },
    glow: { value: null as Texture | null },
    canvas_px: { value: new Vector2(1, 1) },
  };
}
export type SharedUniforms = ReturnType<typeof sharedUniforms>;

export function shader(vertexShader: string, fragmentShader: string, uniforms: Record<string, IUniform>): RawShaderMaterial {
  return new RawShaderMaterial({ glslVersion: GLSL3, vertexShader, fragmentShader, uniforms });
}

/** Materials of surfaces: two for albedos of vertices, one for each albedo texture. */
export class SurfaceMaterials {
  private readonly plain = new Map<Side, RawShaderMaterial>();

  constructor(private readonly uniforms: SharedUniforms) {}

  ofVertices(twoSided: boolean): RawShaderMaterial {
    const side = twoSided ? DoubleSide : FrontSide;
    let material = this.plain.get(side);
    if (!material) {
      material = shader(SURFACE_VERTEX, SURFACE_FRAGMENT, this.uniforms);
      material.side = side;
      this.plain.set(side, material);
    }
    return material;
  }

  ofTexture(twoSided: boolean, albedo: Texture, box: readonly [number, number, number, number]): RawShaderMaterial {
    const own = { albedo_texture: { value: albedo }, box: { value: new Vector4(...box) } };
    const material = shader(SURFACE_VERTEX, SURFACE_FRAGMENT, { ...this.uniforms, ...own });
    material.defines = { TEXTURED: "" };
    material.side = twoSided ? DoubleSide : FrontSide;
    return material;
  }

  dispose(): void {
    for (const material of this.plain.values()) material.dispose();
    this.plain.clear();
  }
}

/** Depths alone, of both sides: rays of light stop at either. */
export function depthMaterial(): RawShaderMaterial {
  const material = shader(DEPTH_VERTEX, DEPTH_FRAGMENT, {});
  material.side = DoubleSide;
  material.colorWrite = false;
  return material;
}
