// Illuminances at given points, by the functions that colour the scene: a point is a pixel of a float picture that is read back.

import {
  BufferGeometry,
  Camera,
  Float32BufferAttribute,
  FloatType,
  Points,
  RGBAFormat,
  Scene,
  Vector2,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import { PROBE_FRAGMENT, PROBE_VERTEX } from "./shaders.ts";
import { type SharedUniforms, shader } from "./uniforms.ts";

const WIDTH = 1024;

/** Illuminance in lx of points [n, 3] in the local frame with normals [n, 3]. */
export function probed(renderer: WebGLRenderer, uniforms: SharedUniforms, points: Float32Array, normals: Float32Array): Float32Array {
  const count = points.length / 3;
  if (!count) return new Float32Array();
  const [width, height] = [Math.min(count, WIDTH), Math.ceil(count / WIDTH)];
  const target = new WebGLRenderTarget(width, height, { type: FloatType, format: RGBAFormat, depthBuffer: false });
  const material = shader(PROBE_VERTEX, PROBE_FRAGMENT, { ...uniforms, probe_px: { value: new Vector2(width, height) } });
  material.depthTest = false;
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(points, 3));
  geometry.setAttribute("normal", new Float32BufferAttribute(normals, 3));
  const dots = new Points(geometry, material);
  dots.frustumCulled = false;
  const scene = new Scene();
  scene.add(dots);
  renderer.setRenderTarget(target);
  renderer.render(scene, new Camera());
  const pixels = new Float32Array(4 * width * height);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  renderer.setRenderTarget(null);
  for (const each of [target, material, geometry]) each.dispose();
  return Float32Array.from({ length: count }, (_, i) => pixels[4 * i]!);
}
