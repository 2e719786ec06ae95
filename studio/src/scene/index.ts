// The scene in three dimensions: what stands there, lit by the lamps as the loop lights it.

import { type Box3, type Camera, Group, Matrix4, type Mesh, Raycaster, Scene, Vector2, Vector3, WebGLRenderer } from "three";
import type { Arrays, Matrix4x4, Vector } from "../arrays.ts";
import type { BeamPoint, MeshesMessage, Run, StepMessage } from "../protocol.ts";
import { Bodies } from "./bodies.ts";
import { Fog } from "./fog.ts";
import { LocalFrame, reference } from "./frames.ts";
import { IsoluxNumbers } from "./isolux.ts";
import { type Label, Labels } from "./labels.ts";
import { Legend } from "./legend.ts";
import { LightAtlas } from "./light_atlas.ts";
import { Markers } from "./markers.ts";
import { drawsInSoftware, Pace } from "./pace.ts";
import { probed } from "./probe.ts";
import { MOST_LAMPS, MOST_MODULES } from "./shaders.ts";
import { ShadowMaps } from "./shadow_maps.ts";
import { FOG_PER_M, SurfaceMaterials, sharedUniforms } from "./uniforms.ts";
import { type Orbit, type Viewpoint, Viewpoints, WALL_M } from "./viewpoints.ts";
import { Wall } from "./wall.ts";

export type { Orbit, Viewpoint } from "./viewpoints.ts";

export interface SceneOptions {
  exposure_ev: number;
  style: "luminance" | "lux";
  isolux: boolean;
  fog: boolean;
  frusta: boolean;
}

/** What is under a pixel: a point of a body and the normal of its surface there, in the world. */
export interface Hit {
  point: Vector;
  normal: Vector;
  /** Name of the object, null on the road. */
  object: string | null;
  distance: number;
}

const BACKGROUND = 0x05070a;

export class SceneView {
  readonly canvas: HTMLCanvasElement;
  /** For what others draw over the scene, in the local frame. */
  readonly overlay = new Group();
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly frame = new LocalFrame();
  private readonly uniforms = sharedUniforms();
  private readonly materials = new SurfaceMaterials(this.uniforms);
  private readonly bodies = new Bodies(this.materials);
  private readonly shadows: ShadowMaps;
  private readonly fog: Fog;
  private readonly markers = new Markers();
  private readonly wall = new Wall(this.materials.ofVertices(false));
  private readonly viewpoints: Viewpoints;
  private readonly pace: Pace;
  private readonly isolux: IsoluxNumbers;
  private readonly labels: Labels;
  private readonly legend: Legend;
  private readonly resizing: ResizeObserver;
  private atlas: LightAtlas | null = null;
  private run: Run | null = null;
  private step: StepMessage | null = null;
  private beamSide: "left" | "right" | null = null;
  private geometryKey = "";
  private due = 0;
  private readonly current: SceneOptions = { exposure_ev: 0, style: "luminance", isolux: false, fog: false, frusta: false };

  /** Throws an Error where the browser has no WebGL 2. */
  constructor(private readonly container: HTMLElement) {
    const software = drawsInSoftware();
    // Several samples a pixel take several times as long in software.
    this.renderer = new WebGLRenderer({ antialias: !software, powerPreference: "high-performance" });
    this.pace = new Pace(this.renderer, software, () => this.render());
    this.renderer.setClearColor(BACKGROUND);
    this.canvas = this.renderer.domElement;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "Road, objects and lamps, and the light on them");
    Object.assign(this.canvas.style, { position: "absolute", inset: "0", display: "block", touchAction: "none" });
    if (getComputedStyle(container).position === "static") container.style.position = "relative";
    container.append(this.canvas);
    this.shadows = new ShadowMaps(this.renderer, this.uniforms);
    this.fog = new Fog(this.renderer, this.uniforms);
    this.scene.add(this.bodies.group, this.wall.group, this.markers.group, this.fog.sky, this.overlay);
    this.isolux = new IsoluxNumbers(this.renderer, this.uniforms);
    this.labels = new Labels(container, this.canvas);
    this.legend = new Legend(container);
    this.viewpoints = new Viewpoints(this.canvas, () => this.changed());
    this.viewpoints.onFrame = () => this.relabel();
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.shadows.invalidate();
      this.changed();
    });
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(container);
    this.resize();
  }

  setOptions(options: SceneOptions): void {
    Object.assign(this.current, options);
    this.changed();
  }

  /** Called when the user moves the orbit camera, so that another view can follow with `setOrbit`. */
  set onMove(call: ((orbit: Orbit) => void) | null) {
    this.viewpoints.onMove = call;
  }

  setOrbit(orbit: Orbit): void {
    this.viewpoints.setOrbit(orbit);
    this.changed();
  }

  setViewpoint(viewpoint: Viewpoint): void {
    this.viewpoints.set(viewpoint);
    this.relabel();
    this.changed();
  }

  /** Forgets all that was shown and takes the modules and the camera of a run. */
  setRun(run: Run): void {
    this.run = run;
    this.step = null;
    this.geometryKey = "";
    this.bodies.clear();
    this.atlas?.dispose();
    this.atlas = new LightAtlas(this.renderer, run.modules.slice(0, MOST_MODULES));
    this.uniforms.light_atlas.value = this.atlas.texture;
    this.uniforms.module_count.value = 0;
    this.uniforms.ambient_lx.value = run.ambient_lx;
    this.markers.setCamera(run.camera);
    this.wall.setPoints([]);
    this.beamSide = null;
    this.relabel();
    this.changed();
  }

  /** Other facts of the run hold. */
  edited(): void {
    if (this.run) this.markers.setCamera(this.run.camera);
    this.changed();
  }

  addMeshes(message: MeshesMessage, arrays: Arrays): void {
    this.bodies.add(message, arrays);
  }

  /** Shows a step. */
  show(step: StepMessage, arrays: Arrays): void {
    const { run, atlas, frame } = this;
    if (!run || !atlas) return;
    this.step = step;
    atlas.update(step, arrays);
    frame.moveTo(step.T_world_body);
    this.bodies.show(step.bodies, frame);
    this.place(step, run);
    this.changed();
  }

  /** Test points of a regulation, seen from a side's lamp. */
  setBeam(points: BeamPoint[], side: "left" | "right"): void {
    this.beamSide = points.length ? side : null;
    this.wall.setPoints(points);
    this.relabel();
    this.changed();
  }

  /** Illuminance in lx by the lamps at world points [n, 3] with unit normals [n, 3], shadows included. */
  probe(points: Float32Array, normals: Float32Array): Float32Array {
    const { x, y, z } = this.frame.origin;
    this.prepareLight();
    this.uniforms.shadows.value = true;
    this.uniforms.extinction_per_m.value = 0;
    const origin = [x, y, z];
    const local = points.map((value, i) => value - origin[i % 3]!);
    const lx = probed(this.renderer, this.uniforms, local, normals);
    this.changed();
    return lx;
  }

  /** World point under a pixel of the canvas in CSS pixels, null where there is nothing. */
  pick(x: number, y: number): Vector | null {
    return this.hit(x, y)?.point ?? null;
  }

  /** What is under a pixel of the canvas in CSS pixels, null where there is nothing. */
  hit(x: number, y: number): Hit | null {
    const target =
      this.viewpoints.viewpoint === "wall"
        ? this.wall.group.children.slice(0, 1)
        : this.bodies.group.children.filter((each) => each.visible);
    this.scene.updateMatrixWorld();
    const hit = this.ray(x, y).intersectObjects<Mesh>(target, false)[0];
    if (!hit) return null;
    const normal = (hit.face?.normal ?? new Vector3(0, 0, 1)).clone().transformDirection(hit.object.matrixWorld);
    const object = hit.object.userData.road === false ? hit.object.name : null;
    return { point: this.frame.world(hit.point), normal: [normal.x, normal.y, normal.z], object, distance: hit.distance };
  }

  /** Two points in the world on the ray of sight through a pixel of the canvas in CSS pixels. */
  sight(x: number, y: number): { eye: Vector; through: Vector } {
    const { origin, direction } = this.ray(x, y).ray;
    return { eye: this.frame.world(origin), through: this.frame.world(origin.clone().add(direction)) };
  }

  /** The ray of sight through a pixel of the canvas in CSS pixels, in the local frame. */
  ray(x: number, y: number): Raycaster {
    const { clientWidth, clientHeight } = this.canvas;
    const caster = new Raycaster();
    // The type of setFromCamera names the two cameras that `viewpoints` can have.
    caster.setFromCamera(new Vector2((2 * x) / clientWidth - 1, 1 - (2 * y) / clientHeight), this.viewpoints.camera);
    return caster;
  }

  /** Pixel of the canvas in CSS pixels at which a point of the local frame is seen, null where it is not. */
  pixel(local: Vector3): Vector2 | null {
    const { x, y, z } = local.clone().project(this.viewpoints.camera);
    if (Math.abs(z) > 1) return null;
    return new Vector2(((x + 1) / 2) * this.canvas.clientWidth, ((1 - y) / 2) * this.canvas.clientHeight);
  }

  get camera(): Camera {
    return this.viewpoints.camera;
  }

  /** Whether dragging moves the orbit camera. */
  set orbits(enabled: boolean) {
    this.viewpoints.orbits = enabled;
  }

  /** What lies on the wall, in the frame of the car's body. */
  get onWall(): Group {
    return this.wall.group;
  }

  /** A pose of the world in the local frame. */
  local(T_world_any: Matrix4x4): Matrix4 {
    return this.frame.pose(T_world_any);
  }

  /** Pose in the world and bounding box of an object, null where it is not there. */
  body(name: string): { T: Matrix4; bounds: Box3 } | null {
    const mesh = this.bodies.find(name);
    if (!mesh) return null;
    if (!mesh.geometry.boundingBox) mesh.geometry.computeBoundingBox();
    const T = new Matrix4().makeTranslation(this.frame.origin).multiply(mesh.matrix);
    return { T, bounds: mesh.geometry.boundingBox!.clone() };
  }

  /** Replaces the labels of one owner, at points of the local frame. */
  label(owner: string, labels: readonly Label[]): void {
    this.labels.set(owner, labels);
    this.changed();
  }

  /** Draw anew: what is on the overlay has changed. */
  redraw(): void {
    this.changed();
  }

  /** Draws what is due at once and in full resolution, for tests and pictures. */
  renderNow(): void {
    cancelAnimationFrame(this.due);
    this.due = 0;
    this.pace.finest();
    this.render();
  }

  dispose(): void {
    cancelAnimationFrame(this.due);
    this.resizing.disconnect();
    this.bodies.clear();
    this.atlas?.dispose();
    for (const each of [
      this.pace,
      this.viewpoints,
      this.shadows,
      this.fog,
      this.markers,
      this.wall,
      this.materials,
      this.isolux,
      this.labels,
      this.legend,
    ])
      each.dispose();
    this.renderer.dispose();
    this.canvas.remove();
  }

  private changed(): void {
    this.due ||= requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    cancelAnimationFrame(this.due);
    this.due = 0;
    if (!this.container.clientWidth || !this.container.clientHeight) return; // hidden; it is resized when it is shown
    this.pace.moving();
    this.render();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.viewpoints.resize(width / height);
    this.relabel();
    this.draw(); // at once, since a canvas of another size is black
  }

  private place(step: StepMessage, run: Run): void {
    const { frame } = this;
    const T_local_body = frame.pose(step.T_world_body);
    const T_local_ground = frame.pose(step.T_world_ground);
    const T_local_module = step.modules.map((module) => frame.pose(module.T_world_module));
    const centres = T_local_module.map((T) => new Vector3().setFromMatrixPosition(T));
    this.viewpoints.follow({ T_local_ground, T_local_body, lamp_height_m: reference(run, null).z });
    this.wall.place(T_local_body);
    this.uniforms.ground_up.value.setFromMatrixColumn(T_local_ground, 2);
    this.relabel();
    const others = [...run.street_lamps, ...step.spotlights].map((lamp) => frame.point(lamp.position_m));
    this.markers.setFields(run.modules, T_local_module);
    this.markers.place(T_local_body, frame.pose(step.T_world_camera), centres, others);
    const key = JSON.stringify([step.T_world_body, step.modules.map((module) => module.T_world_module), step.bodies]);
    if (key !== this.geometryKey) {
      this.geometryKey = key;
      const count = Math.min(run.modules.length, MOST_MODULES);
      this.shadows.place(run.modules.slice(0, count), T_local_body, T_local_module.slice(0, count));
    }
    this.placeOtherLamps(step, run);
  }

  private placeOtherLamps(step: StepMessage, run: Run): void {
    const { frame, uniforms } = this;
    const streets = this.brightest(run.street_lamps);
    uniforms.street_count.value = streets.length;
    streets.forEach((lamp, i) => {
      const { x, y, z } = frame.point(lamp.position_m);
      uniforms.street_lamps.value[i]!.set(x, y, z, lamp.intensity_cd);
    });
    const spots = this.brightest(step.spotlights);
    uniforms.spot_count.value = spots.length;
    spots.forEach((spot, i) => {
      const { x, y, z } = frame.point(spot.position_m);
      uniforms.spot_position.value[i]!.set(x, y, z, spot.intensity_cd);
      uniforms.spot_axis.value[i]!.set(...spot.axis);
      uniforms.spot_width.value[i]!.set(...spot.width_deg);
    });
  }

  /** Those that give most light beside the car, as many as the shader takes. */
  private brightest<Lamp extends { position_m: Vector; intensity_cd: number }>(lamps: readonly Lamp[]): Lamp[] {
    const light = (lamp: Lamp) => lamp.intensity_cd / (100 + this.frame.point(lamp.position_m).lengthSq());
    return [...lamps].sort((a, b) => light(b) - light(a)).slice(0, MOST_LAMPS);
  }

  private relabel(): void {
    const { run } = this;
    const { onWall, viewpoint } = this.viewpoints;
    const wall = viewpoint === "wall";
    if (run && wall) this.wall.lookFrom(reference(run, this.beamSide), onWall.right - onWall.left);
    this.labels.set("wall", run && wall ? this.wall.labels(onWall, reference(run, null).z) : []);
  }

  /** Uniforms of the modules that shine, and their shadow maps. */
  private prepareLight(): void {
    const { run, step, atlas, uniforms, frame } = this;
    if (!run || !step || !atlas) return;
    const lit = run.modules
      .map((_, k) => k)
      .filter((k) => k < MOST_MODULES && k < step.modules.length && step.modules[k]!.scale_cd > 0 && atlas.isLit(k));
    uniforms.module_count.value = lit.length;
    lit.forEach((k, slot) => {
      const { left, right, bottom, top } = run.modules[k]!;
      const { T_world_module, scale_cd } = step.modules[k]!;
      const T = frame.pose(T_world_module);
      uniforms.module_position.value[slot]!.setFromMatrixPosition(T);
      uniforms.module_pose.value[slot]!.copy(T).invert();
      uniforms.module_borders.value[slot]!.set(left, right, bottom, top);
      uniforms.module_place.value[slot]!.copy(atlas.places[k]!);
      uniforms.module_light.value[slot]!.set(scale_cd, this.shadows.map(k));
    });
    const wall = this.wall.group.visible;
    this.wall.group.visible = false;
    this.scene.visible = this.bodies.group.visible = true;
    this.shadows.render(this.scene, (k) => lit.includes(k));
    this.wall.group.visible = wall;
  }

  private render(): void {
    const { run, step, uniforms, viewpoints, current } = this;
    const { camera, viewpoint } = viewpoints;
    const wall = viewpoint === "wall";
    this.legend.show(current.style === "lux" || current.isolux, current.isolux);
    this.scene.visible = step !== null;
    if (run && step) {
      this.prepareLight();
      const fog = current.fog && !wall && current.style === "luminance";
      uniforms.shadows.value = !wall; // nothing stands before the wall, the road neither
      uniforms.extinction_per_m.value = fog ? FOG_PER_M : 0;
      uniforms.eye_extinction_per_m.value = fog && !viewpoints.isFlat ? FOG_PER_M : 0; // parallel rays come from infinitely far away
      uniforms.luminance_gain.value = 2 ** current.exposure_ev / (wall ? whiteOfWall(run) : run.white_cd_m2);
      uniforms.lux.value = current.style === "lux";
      uniforms.lines.value = current.isolux;
      uniforms.fog.value = fog;
      uniforms.ambient_lx.value = wall ? 0 : run.ambient_lx;
      if (wall) uniforms.street_count.value = uniforms.spot_count.value = 0;
      else this.placeOtherLamps(step, run);
      this.renderer.getDrawingBufferSize(uniforms.canvas_px.value);
      this.bodies.group.visible = !wall;
      this.wall.group.visible = wall;
      this.markers.show(viewpoint, current.frusta);
      this.fog.sky.visible = false;
      if (fog) this.fog.render(this.scene, camera, uniforms.canvas_px.value.x, uniforms.canvas_px.value.y);
      this.fog.sky.visible = fog;
    }
    this.overlay.visible = !wall;
    this.labels.set("isolux", current.isolux && step ? this.isolux.labels(this.scene, camera) : []);
    this.renderer.render(this.scene, camera);
    this.labels.update(camera, this.container.clientWidth, this.container.clientHeight, this.legend.corner);
  }
}

/** Luminance in cd/m^2 that the wall is exposed for: what lights a road well would leave a wall at 25 m white all over. */
function whiteOfWall(run: Run): number {
  const peak_cd = Math.max(...run.modules.map((module) => module.peak_cd));
  const sides = new Set(run.modules.map((module) => module.side)).size;
  return Math.max((sides * peak_cd) / WALL_M ** 2 / Math.PI, 1e-3);
}
