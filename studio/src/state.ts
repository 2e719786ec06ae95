// What the page knows, and how it is shown.

import type { Arrays, Picture } from "./arrays.ts";
import type { Link } from "./connection.ts";
import type { Off } from "./model/overrides.ts";
import type { Schema } from "./model/schema.ts";
import type {
  BeamPoint,
  ChoicesMessage,
  ErrorMessage,
  Mark,
  MeterMessage,
  Model,
  PlaceMessage,
  ScenarioMessage,
  StatusMessage,
  StepMessage,
  WishMessage,
} from "./protocol.ts";
import { Rows } from "./rows.ts";
import type { SceneOptions, Viewpoint } from "./scene/index.ts";
import { Store } from "./store.ts";

export type { Viewpoint };
export type PanelName = "scene" | "camera" | "matrix" | "curves";
export type Tool = "move" | "turn" | "scale";
export type Side = "left" | "right";
/** What a click in the scene does in place of choosing: light painted in the world, or measuring. */
export type Aim = "find" | "light" | "lux" | "probe" | "line";

/** The camera's newest pictures and the marks of the same step. */
export interface Look {
  step: number;
  on?: Picture;
  off?: Picture;
  symbol?: Picture;
  marks: Mark[];
}

/** What came of one run. Its parts are replaced or grow; the state's `*_version` says that some did. */
export class RunData {
  readonly rows: Rows;
  readonly utilisations = new Map<number, Uint8Array>();
  shown: StepMessage | null = null;
  newest = -1;
  look: Look | null = null;
  summary: unknown = null;

  constructor(scenario: ScenarioMessage, run: number) {
    this.rows = new Rows(scenario.runs[run].columns);
  }

  /** Take what a step brought. Returns which of the panels have something new. */
  take(message: StepMessage, arrays: Arrays): { camera: boolean; matrix: boolean } {
    this.shown = message;
    if (!message.scrub) this.newest = message.step;
    const on = arrays.get("camera.on");
    const marksOnly = !on && !message.scrub && this.look?.on !== undefined;
    if (!marksOnly) {
      this.look = { step: message.step, on, off: arrays.get("camera.off"), symbol: arrays.get("camera.symbol"), marks: message.marks };
    }
    let matrix = false;
    for (const [name, { values }] of arrays) {
      const found = /^u\.(\d+)$/.exec(name);
      if (!found || !(values instanceof Uint8Array)) continue;
      this.utilisations.set(Number(found[1]), values);
      matrix = true;
    }
    return { camera: !marksOnly, matrix };
  }
}

export interface Beam {
  side: Side;
  rule: string;
  points: BeamPoint[];
}

export interface State extends SceneOptions {
  link: Link;
  role: "edit" | "watch" | null;
  id: number | null;
  status: StatusMessage | null;
  progress: string | null;
  choices: ChoicesMessage | null;
  scenario: ScenarioMessage | null;
  /** How many edits the server has answered. */
  answered: number;
  /** The last answer on light in the world. */
  light: PlaceMessage | WishMessage | ErrorMessage | null;
  /** The last answer of the light meter. */
  meter: MeterMessage | ErrorMessage | null;
  /** The last edit by `Session.edit` that the server refused, and why. */
  refused: { overrides: string[]; text: string } | null;
  /** Whether edits of this page are not answered yet. */
  edits_pending: boolean;
  /** The scenario of the first run as it is now. */
  model: Model | null;
  /** What is switched off. */
  off: readonly Off[];
  /** Of the scenario model; null until it was asked for. */
  schema: Schema | null;
  runs: RunData[];
  /** The step that is looked at again; null follows the newest. */
  scrub: number | null;

  step_version: number;
  rows_version: number;
  camera_version: number;
  matrix_version: number;
  summary_version: number;

  viewpoint: Viewpoint;
  rule: string;
  side: Side;
  beams: (Beam | null)[];

  camera_run: number;
  /** Pictures that the camera's panel shows beside the frame with the light on. */
  pictures: readonly ("off" | "symbol")[];
  matrix_run: number;
  maximised: PanelName | null;
  keys_open: boolean;
  /** Whether this page drives the car. */
  driving: boolean;

  /** Keys of the things that are chosen in the scene, and what dragging their handles does. */
  chosen: readonly string[];
  tool: Tool;
  aim: Aim | null;
  /** Whether the things are listed beside the scene. */
  things: boolean;
}

export type Studio = Store<State>;

export function newStore(): Studio {
  return new Store<State>({
    link: "connecting",
    role: null,
    id: null,
    status: null,
    progress: null,
    choices: null,
    scenario: null,
    answered: 0,
    light: null,
    meter: null,
    refused: null,
    edits_pending: false,
    model: null,
    off: [],
    schema: null,
    runs: [],
    scrub: null,
    step_version: 0,
    rows_version: 0,
    camera_version: 0,
    matrix_version: 0,
    summary_version: 0,
    viewpoint: "orbit",
    exposure_ev: 0,
    style: "luminance",
    isolux: false,
    fog: false,
    frusta: false,
    rule: "",
    side: "left",
    beams: [],
    camera_run: 0,
    pictures: [],
    matrix_run: 0,
    maximised: null,
    driving: false,
    keys_open: false,
    chosen: [],
    tool: "move",
    aim: null,
    things: false,
  });
}

/** Whether this client may steer. */
export function hasPen({ link, status, id }: Readonly<State>): boolean {
  return link === "open" && status !== null && id !== null && status.pen === id;
}

/** Disables elements while this page may not steer. */
export function needsPen(store: Studio, ...elements: { disabled: boolean }[]): void {
  store.on(["link", "status", "id"], (state) => {
    const disabled = !hasPen(state);
    for (const each of elements) if (each.disabled !== disabled) each.disabled = disabled;
  });
}

/** Number of the newest step of all runs, -1 before the first. */
export function newestStep({ runs }: Readonly<State>): number {
  return Math.max(-1, ...runs.map(({ newest, rows }) => Math.max(newest, rows.count - 1)));
}
