// Light that fog scatters towards the eye, at a fraction of the canvas's resolution: it has no sharp edges.

import {
  BufferGeometry,
  type Camera,
  DepthTexture,
  Float32BufferAttribute,
  FloatType,
  HalfFloatType,
  LinearFilter,
  Matrix4,
  Mesh,
  NearestFilter,
  type RawShaderMaterial,
  RedFormat,
  Scene,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import { SOLID } from "./bodies.ts";
import { FOG_FRAGMENT, SCREEN_VERTEX, SKY_FRAGMENT } from "./shaders.ts";
import { depthMaterial, FOG_PER_M, type SharedUniforms, shader } from "./uniforms.ts";

const SHARE = 1 / 4; // of the canvas's resolution
const ASYMMETRY = 0.8;
const FARTHEST_M = 300;

export class Fog {
  /** To be drawn with the scene: the fog where nothing stands behind it. */
  readonly sky: Mesh;
  private readonly depth: WebGLRenderTarget;
  private readonly glow: WebGLRenderTarget;
  private readonly onlyDepth: RawShaderMaterial = depthMaterial();
  private readonly march: RawShaderMaterial;
  private readonly screen = new Scene();
  private readonly local_from_clip = { value: new Matrix4() };

  constructor(
    private readonly renderer: WebGLRenderer,
    uniforms: SharedUniforms,
  ) {
    this.depth = new WebGLRenderTarget(1, 1, { format: RedFormat });
    this.depth.depthTexture = new DepthTexture(1, 1, FloatType);
    this.depth.depthTexture.magFilter = this.depth.depthTexture.minFilter = NearestFilter;
    this.glow = new WebGLRenderTarget(1, 1, { format: RedFormat, type: HalfFloatType, depthBuffer: false });
    this.glow.texture.magFilter = this.glow.texture.minFilter = LinearFilter;
    uniforms.glow.value = this.glow.texture;
    const { glow: _, ...others } = uniforms; // a pass must not read what it writes
    this.march = shader(SCREEN_VERTEX, FOG_FRAGMENT, {
      ...others,
      scene_depth: { value: this.depth.depthTexture },
      local_from_clip: this.local_from_clip,
      scattering_per_m: { value: FOG_PER_M },
      asymmetry: { value: ASYMMETRY },
      farthest_m: { value: FARTHEST_M },
    });
    this.march.depthTest = this.march.depthWrite = false;
    this.screen.add(wholeScreen(this.march));
    this.sky = wholeScreen(shader(SCREEN_VERTEX, SKY_FRAGMENT, uniforms));
    this.sky.renderOrder = 1; // after what hides it
    (this.sky.material as RawShaderMaterial).depthWrite = false;
    this.sky.visible = false;
  }

  /** Draws the glow for a canvas of that many pixels. */
  render(scene: Scene, camera: Camera, width: number, height: number): void {
    const [w, h] = [Math.max(Math.ceil(width * SHARE), 1), Math.max(Math.ceil(height * SHARE), 1)];
    this.depth.setSize(w, h);
    this.glow.setSize(w, h);
    const { renderer } = this;
    const layers = camera.layers.mask;
    camera.layers.set(SOLID);
    scene.overrideMaterial = this.onlyDepth;
    renderer.setRenderTarget(this.depth);
    renderer.render(scene, camera);
    scene.overrideMaterial = null;
    camera.layers.mask = layers;
    this.local_from_clip.value.multiplyMatrices(camera.matrixWorld, camera.projectionMatrixInverse);
    renderer.setRenderTarget(this.glow);
    renderer.render(this.screen, camera);
    renderer.setRenderTarget(null);
  }

  dispose(): void {
    this.depth.depthTexture?.dispose();
    this.depth.dispose();
    this.glow.dispose();
    this.onlyDepth.dispose();
    this.march.dispose();
    (this.sky.material as RawShaderMaterial).dispose();
  }
}

function wholeScreen(material: RawShaderMaterial): Mesh {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(new Float32Array(9), 3)); // three counts vertices by it
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}
