// Made from the messages in Python by scripts/protocol.py.

export type View = "scene" | "light" | "camera" | "off" | "symbol" | "matrix" | "marks" | "frames" | "depth" | "instances" | "materials" | "truth";

export interface Named {
  name: string;
  description: string;
}

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

export interface StreetLamp {
  position_m: [number, number, number];
  intensity_cd: number;
}

export interface Run {
  label: string;
  overrides: string[];
  controllers: Record<string, string>;
  columns: Column[];
  lamps: Record<string, [number, number, number]>;
  modules: Module[];
  camera: Camera;
  ambient_lx: number;
  white_cd_m2: number;
  road: string;
  street_lamps: StreetLamp[];
}

export interface Model {
  steps: number;
  seed: number;
  [key: string]: unknown;
}

export interface MeshHead {
  id: number;
  object: string;
  kind: "road" | "object";
  two_sided: boolean;
  box?: [number, number, number, number];
}

export interface Mark {
  lines: [[number, number], [number, number]][];
  kind: "tracked" | "masked" | "found" | "target" | "zone";
  text: string;
  at: [number, number];
}

export interface ModulePose {
  T_world_module: number[];
  scale_cd: number;
}

export interface BodyPose {
  mesh: number;
  T_world_body: number[];
}

export interface Spotlight {
  position_m: [number, number, number];
  axis: [number, number, number];
  intensity_cd: number;
  width_deg: [number, number];
}

export interface Symbol {
  pose: [number, number, number, number];
  loss: string;
  target: [number, number, number][];
}

export interface BeamPoint {
  id: string;
  where: [number, number] | null;
  value: number;
  unit: string;
  limit: string;
  passed: boolean | null;
}

export interface Reading {
  surface: string;
  point_m: [number, number, number];
  ground_m: [number, number, number];
  normal: [number, number, number];
  h_deg: number;
  v_deg: number;
  distance_m: number;
  cd: number;
  lx: number;
  vertical_lx: number;
  cd_m2: number | null;
}

export interface ModulePixels {
  module: number;
  pixels: number[];
  cd: number;
}

export interface ScenarioMessage {
  type: "scenario";
  number: number;
  name: string;
  source: string;
  steps: number;
  rate_hz: number;
  seed: number;
  runs: Run[];
  model: Model;
  acts: Record<string, "step" | "prepared" | "restart">;
}

export interface ChoicesMessage {
  type: "choices";
  scenarios: Named[];
  controllers: Named[];
  rules: string[];
  symbols: string[];
  lamps: string[];
  recordings: Named[];
}

export interface MeshesMessage {
  type: "meshes";
  run: number;
  meshes: MeshHead[];
}

export interface StepMessage {
  type: "step";
  id: number;
  run: number;
  step: number;
  time_s: number;
  scrub: boolean;
  T_world_ground: number[];
  T_world_body: number[];
  T_world_camera: number[];
  modules: ModulePose[];
  light_windows: Record<string, [number, number, number, number]>;
  bodies: BodyPose[];
  spotlights: Spotlight[];
  symbols: Record<string, Symbol>;
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
  recording: string | null;
}

export interface WelcomeMessage {
  type: "welcome";
  protocol: number;
  version: string;
  role: "edit" | "watch";
  id: number;
}

export interface ErrorMessage {
  type: "error";
  text: string;
  about: string | null;
}

export interface ProgressMessage {
  type: "progress";
  text: string | null;
}

export interface EditMessage {
  type: "edit";
  run: number;
  step: number;
  overrides: string[];
  model: Model | null;
  facts: Run | null;
}

export interface SavedMessage {
  type: "saved";
  name: string;
  text: string;
}

export interface SchemaMessage {
  type: "schema";
  schema: Record<string, unknown>;
}

export interface SummaryMessage {
  type: "summary";
  run: number;
  summary: Record<string, unknown>;
}

export interface BeamMessage {
  type: "beam";
  run: number;
  rule: string;
  side: string;
  points: BeamPoint[];
}

export interface MeterMessage {
  type: "meter";
  run: number;
  step: number;
  readings: (Reading | null)[];
}

export interface PlaceMessage {
  type: "place";
  point_m: [number, number, number];
  modules: ModulePixels[];
}

export interface WishMessage {
  type: "wish";
  on: "road" | "wall";
  wanted_lx: number;
  given_lx: number;
  rmse_lx: number;
  worst_lx: number;
  pixels: number;
}

export interface HelloRequest {
  ask?: number | null;
  type: "hello";
  token: string;
  name?: string;
}

export interface WantRequest {
  ask?: number | null;
  type: "want";
  shared?: boolean;
  views: ("scene" | "light" | "camera" | "off" | "symbol" | "matrix" | "marks" | "frames" | "depth" | "instances" | "materials" | "truth")[];
}

export interface ScrubRequest {
  ask?: number | null;
  type: "scrub";
  run?: number;
  step: number | null;
}

export interface SummaryRequest {
  ask?: number | null;
  type: "summary";
  run?: number;
}

export interface BeamRequest {
  ask?: number | null;
  type: "beam";
  run?: number;
  rule: string;
  side?: "left" | "right";
  step?: number | null;
}

export interface MeterRequest {
  ask?: number | null;
  type: "meter";
  run?: number;
  step?: number | null;
  on?: "scene" | "wall";
  eye_m: [number, number, number];
  through_m: [number, number, number][];
  side?: "left" | "right" | null;
}

export interface AcknowledgeRequest {
  ask?: number | null;
  type: "shown";
  id: number;
}

export interface ButtonRequest {
  ask?: number | null;
  type: "pen" | "play" | "pause" | "step" | "reset" | "undo" | "redo" | "save" | "schema";
}

export interface SpeedRequest {
  ask?: number | null;
  type: "speed";
  factor: number | null;
}

export interface OpenRequest {
  ask?: number | null;
  type: "open";
  name?: string;
  overrides?: string[];
  recording?: string | null;
}

export interface SetRequest {
  ask?: number | null;
  type: "set";
  overrides: string[];
}

export interface RecordRequest {
  ask?: number | null;
  type: "record";
  folder: string | null;
}

export interface CompareRequest {
  ask?: number | null;
  type: "compare";
  overrides?: string[] | null;
  recording?: string | null;
}

export interface DriveRequest {
  ask?: number | null;
  type: "drive";
  throttle: number | null;
  steering: number | null;
}

export interface PaintRequest {
  ask?: number | null;
  type: "paint";
  stroke?: number;
  module: number;
  box: [number, number, number, number];
  over?: boolean;
}

export interface PlaceRequest {
  ask?: number | null;
  type: "place";
  stroke?: number;
  point_m: [number, number, number];
  value?: number | null;
  over?: boolean;
}

export interface WishRequest {
  ask?: number | null;
  type: "wish";
  on?: "road" | "wall";
  box_m: [number, number, number, number];
  over?: boolean;
}

export type ServerMessage = ScenarioMessage | ChoicesMessage | MeshesMessage | StepMessage | RowsMessage | StatusMessage | WelcomeMessage | ErrorMessage | ProgressMessage | EditMessage | SavedMessage | SchemaMessage | SummaryMessage | BeamMessage | MeterMessage | PlaceMessage | WishMessage;

export type ClientMessage = HelloRequest | WantRequest | ScrubRequest | SummaryRequest | BeamRequest | MeterRequest | AcknowledgeRequest | ButtonRequest | SpeedRequest | OpenRequest | SetRequest | RecordRequest | CompareRequest | DriveRequest | PaintRequest | PlaceRequest | WishRequest;
