// Messages of the studio's WebSocket, as docs/programs.md describes them.

import type { Schema } from "./model/schema.ts";

/** 16 numbers of a 4 x 4 matrix, row by row; `T_a_b` takes points of frame b to frame a. Frames are x forward, y left, z up. */
export type Matrix4x4 = number[];
export type Vector = [number, number, number];

/** An array of a message's body. rows x columns and so on are in `shape`. */
export type Values = Uint8Array | Uint16Array | Uint32Array | Float32Array;
export interface Picture {
  readonly shape: number[];
  /** Of a `png`. */
  readonly bitmap?: ImageBitmap;
  /** Of all others; half floats (`f2`) come as their 16 bits, in a Uint16Array. */
  readonly values?: Values;
}
export type Arrays = ReadonlyMap<string, Picture>;

export interface Module {
  name: string;
  side: "left" | "right";
  rows: number;
  cols: number;
  left: number;
  right: number;
  bottom: number;
  top: number;
  pixel_rows: number;
  pixel_cols: number;
  peak_cd: number;
  flux_lm: number;
  /** Least and greatest turn from rest. */
  swivel_deg: [number, number];
  level_deg: [number, number];
}

export interface Camera {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  bits: number;
  saturation_cd_m2: number;
}

export interface Column {
  name: string;
  unit: string;
  description: string;
}

export interface Run {
  label: string;
  overrides: string[];
  controllers: Record<string, string>;
  columns: Column[];
  modules: Module[];
  camera: Camera;
  ambient_lx: number;
  white_cd_m2: number;
  road: string;
  street_lamps: { position_m: Vector; intensity_cd: number }[];
}

/** The scenario as it is now, with all defaults. */
export type Model = { steps: number; seed: number } & Record<string, unknown>;
export type Acts = "step" | "prepared" | "restart";

export interface Named {
  name: string;
  description: string;
}

export interface ScenarioMessage {
  type: "scenario";
  name: string;
  source: string;
  steps: number;
  rate_hz: number;
  seed: number;
  runs: Run[];
  model: Model;
  /** When keys act, by the beginning of a key; the longest counts. */
  acts: Record<string, Acts>;
}

export interface ChoicesMessage {
  type: "choices";
  scenarios: Named[];
  controllers: Named[];
  rules: string[];
  symbols: string[];
  lamps: string[];
  /** Names are folders. */
  recordings: Named[];
}

export interface MeshHead {
  id: number;
  object: string;
  kind: "road" | "object";
  two_sided: boolean;
  /** Of a texture: [x_min, y_min, x_max, y_max] in m of the body's frame. */
  box?: [number, number, number, number];
}

export interface MeshesMessage {
  type: "meshes";
  run: number;
  meshes: MeshHead[];
}

export interface Mark {
  lines: [[number, number], [number, number]][];
  kind: "tracked" | "masked" | "found" | "target" | "zone";
  text: string;
  at: [number, number];
}

export interface StepMessage {
  type: "step";
  id: number;
  run: number;
  step: number;
  time_s: number;
  scrub: boolean;
  T_world_ground: Matrix4x4;
  T_world_body: Matrix4x4;
  T_world_camera: Matrix4x4;
  modules: { T_world_module: Matrix4x4; scale_cd: number }[];
  /** First row, last + 1, first column, last + 1 of the texels in `light.K`. */
  light_windows: Record<string, [number, number, number, number]>;
  bodies: { mesh: number; T_world_body: Matrix4x4 }[];
  spotlights: { position_m: Vector; axis: Vector; intensity_cd: number; width_deg: [number, number] }[];
  symbols: Record<string, { pose: [number, number, number, number]; loss: string; target: Vector[] }>;
  marks: Mark[];
  notes: string[];
}

export interface RowsMessage {
  type: "rows";
  run: number;
  first: number;
}

export interface StatusMessage {
  type: "status";
  playing: boolean;
  speed: number | null;
  pen: number | null;
  clients: number;
  step_ms: number | null;
  real_time: number | null;
  failed: string | null;
  /** Folder below runs that the first run is recorded into. */
  recording: string | null;
}

export interface BeamPoint {
  id: string;
  where: [number, number] | null;
  value: number;
  unit: string;
  limit: string;
  passed: boolean | null;
}

export type ServerMessage =
  | { type: "welcome"; protocol: number; version: string; role: "edit" | "watch"; id: number }
  | ErrorMessage
  | { type: "progress"; text: string | null }
  | StatusMessage
  | ChoicesMessage
  | ScenarioMessage
  | MeshesMessage
  | StepMessage
  | RowsMessage
  | { type: "edit"; run: number; step: number; overrides: string[]; model: Model | null; facts: Run | null }
  | { type: "saved"; name: string; text: string }
  | { type: "schema"; schema: Schema }
  | PlaceAnswer
  | WishAnswer
  | { type: "summary"; run: number; summary: unknown }
  | { type: "beam"; run: number; rule: string; side: string; points: BeamPoint[] };

export interface PlaceAnswer {
  type: "place";
  point_m: Vector;
  modules: { module: number; pixels: number[]; cd: number }[];
}

export interface WishAnswer {
  type: "wish";
  on: "road" | "wall";
  wanted_lx: number;
  rmse_lx: number;
  worst_lx: number;
  pixels: number;
}

export interface ErrorMessage {
  type: "error";
  text: string;
  about: string | null;
}

/** To `place` and `wish`. */
export type LightAnswer = PlaceAnswer | WishAnswer | ErrorMessage;

/** With arrays `value` and `painted`, u1. box: first row, end row, first column, end column. */
export interface PaintMessage {
  type: "paint";
  stroke: number;
  module: number;
  box: [number, number, number, number];
  over: boolean;
}

export type View = "scene" | "light" | "camera" | "matrix" | "marks";

export type ClientMessage =
  | { type: "hello"; token: string; name: string }
  | { type: "want"; views: View[] }
  | { type: "scrub"; run: number; step: number | null }
  | { type: "summary"; run: number }
  | { type: "beam"; run: number; rule: string; side: "left" | "right"; step: number | null }
  | { type: "schema" }
  | { type: "shown"; id: number }
  | { type: "pen" | "play" | "pause" | "step" | "reset" | "undo" | "redo" | "save" }
  | { type: "record"; folder: string | null }
  | { type: "speed"; factor: number | null }
  | { type: "drive"; throttle: number | null; steering: number | null }
  | { type: "open"; name: string; overrides: string[]; recording: string | null }
  | { type: "set"; overrides: string[] }
  | { type: "compare"; overrides: string[] | null; recording?: string | null }
  | PaintMessage
  | { type: "place"; stroke: number; point_m: Vector; value: number | null; over: boolean }
  | { type: "wish"; on: "road" | "wall"; box_m: [number, number, number, number]; over: boolean };
