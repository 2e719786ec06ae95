// Depths as the lamps see them: one map for the modules of a side that light a narrow field, one for those that light a wide one, so that
// the shadows of the fine modules are not drawn with the few texels that cornering light leaves for them.

import {
  Camera,
  DepthTexture,
  FloatType,
  type Matrix4,
  NearestFilter,
  type RawShaderMaterial,
  RedFormat,
  type Scene,
  Vector3,
  Vector4,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import type { Module } from "../protocol.ts";
import { SOLID } from "./bodies.ts";
import { ISO_FROM_OPENGL, OPENGL_FROM_ISO } from "./frames.ts";
import { MOST_MAPS } from "./shaders.ts";
import { depthMaterial, type SharedUniforms } from "./uniforms.ts";

const NEAREST_M = 0.05;
const FARTHEST_M = 500;
const WIDTH = 2048;
const HEIGHT = 768;
const WIDE = 0.8; // tangent from the car's axis
const STEEPEST = 8; // tangent of a map's border
const MARGIN = 4; // texels

interface ShadowMap {
  modules: number[];
  lit: boolean;
  stale: boolean;
  camera: Camera;
}

export class ShadowMaps {
  private readonly target: WebGLRenderTarget;
  private readonly material: RawShaderMaterial = depthMaterial();
  private readonly maps: ShadowMap[];
  private readonly ofModule: number[] = [];

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly uniforms: SharedUniforms,
  ) {
    this.target = new WebGLRenderTarget(WIDTH, MOST_MAPS * HEIGHT, { format: RedFormat, generateMipmaps: false });
    this.target.depthTexture = new DepthTexture(WIDTH, MOST_MAPS * HEIGHT, FloatType);
    this.target.depthTexture.magFilter = this.target.depthTexture.minFilter = NearestFilter;
    this.target.scissorTest = true;
    this.maps = Array.from({ length: MOST_MAPS }, () => ({ modules: [], lit: false, stale: true, camera: new Camera() }));
    for (const { camera } of this.maps) {
      camera.matrixAutoUpdate = camera.matrixWorldAutoUpdate = false;
      camera.layers.set(SOLID);
    }
    uniforms.shadow_maps.value = this.target.depthTexture;
    uniforms.map_range.value.set(1 / NEAREST_M, 1 / FARTHEST_M);
  }

  /** Number of the map of a module. */
  map(module: number): number {
    return this.ofModule[module] ?? 0;
  }

  /** Places the maps for poses of body and modules in the local frame. */
  place(modules: readonly Module[], T_local_body: Matrix4, T_local_module: readonly Matrix4[]): void {
    const T_body_local = T_local_body.clone().invert();
    const corners = modules.map((module, k) => fieldCorners(module, T_body_local.clone().multiply(T_local_module[k]!)));
    for (const map of this.maps) map.modules = [];
    modules.forEach((module, k) => {
      const wide = corners[k]!.some(([y, z]) => Math.max(Math.abs(y), Math.abs(z)) > WIDE);
      this.ofModule[k] = (module.side === "left" ? 0 : 1) + (wide ? 2 : 0);
      this.maps[this.ofModule[k]!]!.modules.push(k);
    });
    this.maps.forEach((map, number) => {
      map.stale = true;
      if (!map.modules.length) return;
      const position = new Vector3();
      for (const k of map.modules) position.add(new Vector3().setFromMatrixPosition(T_local_module[k]!));
      position.divideScalar(map.modules.length);
      this.aim(number, T_local_body.clone().setPosition(position), borders(map.modules.flatMap((k) => corners[k]!)));
    });
  }

  /** Says that something else than lamps has moved. */
  invalidate(): void {
    for (const map of this.maps) map.stale = true;
  }

  /** Draws the maps that are out of date and of which a module shines. */
  render(scene: Scene, isLit: (module: number) => boolean): void {
    const due = this.maps.map((map, number) => ({ map, number })).filter(({ map }) => map.stale && map.modules.some(isLit));
    if (!due.length) return;
    const { renderer, target } = this;
    scene.overrideMaterial = this.material;
    for (const { map, number } of due) {
      target.viewport.set(0, number * HEIGHT, WIDTH, HEIGHT);
      target.scissor.copy(target.viewport);
      renderer.setRenderTarget(target);
      renderer.render(scene, map.camera);
      map.stale = false;
    }
    scene.overrideMaterial = null;
    renderer.setRenderTarget(null);
  }

  dispose(): void {
    this.target.depthTexture?.dispose();
    this.target.dispose();
    this.material.dispose();
  }

  private aim(number: number, T_local_map: Matrix4, { x: left, y: right, z: bottom, w: top }: Vector4): void {
    const { camera } = this.maps[number]!;
    camera.matrixWorld.multiplyMatrices(T_local_map, ISO_FROM_OPENGL);
    camera.matrixWorldInverse.multiplyMatrices(OPENGL_FROM_ISO, this.uniforms.map_pose.value[number]!.copy(T_local_map).invert());
    const n = NEAREST_M;
    camera.projectionMatrix.makePerspective(-left * n, -right * n, top * n, bottom * n, n, FARTHEST_M);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    this.uniforms.map_borders.value[number]!.set(left, right, bottom, top);
    this.uniforms.map_place.value[number]!.set(0, number * HEIGHT, WIDTH, HEIGHT);
  }
}

/** Tangents (y, z) of the corners of a module's field, in the axes of the body. */
function fieldCorners(module: Module, T_body_module: Matrix4): [number, number][] {
  const corners = [module.left, module.right].flatMap((y) => [module.bottom, module.top].map((z) => new Vector3(1, y, z)));
  return corners.map((ray) => {
    const { x, y, z } = ray.transformDirection(T_body_module);
    const ahead = Math.max(x, Math.hypot(y, z) / (2 * STEEPEST));
    return [y / ahead, z / ahead];
  });
}

/** Left, right, bottom and top around corners, with a margin for the filter. */
function borders(corners: [number, number][]): Vector4 {
  const within = (value: number) => Math.min(Math.max(value, -STEEPEST), STEEPEST);
  const [y, z] = [corners.map((corner) => within(corner[0])), corners.map((corner) => within(corner[1]))];
  const [left, right, bottom, top] = [Math.max(...y), Math.min(...y), Math.min(...z), Math.max(...z)];
  const [wide, high] = [((left - right) / WIDTH) * MARGIN, ((top - bottom) / HEIGHT) * MARGIN];
  return new Vector4(left + wide, right - wide, bottom - high, top + high);
}
