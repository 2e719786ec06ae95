// Choosing, moving, adding and removing things in the scene. What is dragged is shown at once, and told to the server as an edit.

import { Matrix4, Vector2, Vector3 } from "three";
import { override, patched, type Table, valueAt } from "../model/overrides.ts";
import type { StepMessage } from "../protocol.ts";
import type { SceneView } from "../scene/index.ts";
import type { Session } from "../session.ts";
import { hasPen, type Studio, type Tool } from "../state.ts";
import { Gizmo } from "./gizmo.ts";
import { COLOURS, type Met, Outlines } from "./outlines.ts";
import { FRAMES, type Frame, type Thing } from "./thing.ts";
import { thingsOf } from "./things.ts";

/** Something that the next clicks in the scene do instead of choosing. */
export interface Clicking {
  /** What to do, for the user. */
  say: string;
  click(x: number, y: number): void;
  /** What the key Enter does. */
  done?(): void;
  ended?(): void;
}

interface Drag {
  base: Frame;
  /** before: values at its beginning of the keys that it has changed so far. */
  parts: { thing: Thing; T_base: Matrix4; before: Map<string, number> }[];
}

export class Placing {
  things: Thing[] = [];
  clicking: Clicking | null = null;
  /** Whether places and angles are free, not in steps. */
  free = false;
  /** Called after each change of things or of what clicks do. */
  onChange: (() => void)[] = [];
  readonly gizmo: Gizmo;
  private readonly outlines = new Outlines();
  private readonly drafts = new Map<string, number>();
  private source = ""; // of the scenario
  private readonly waiting: (() => void)[] = [];
  private readonly sent = new Set<string>();
  private drag: Drag | null = null;

  constructor(
    readonly store: Studio,
    private readonly session: Session,
    readonly view: SceneView,
    toast: (sentence: string) => void,
  ) {
    this.gizmo = new Gizmo(view, { begin: () => this.begin(), moved: (D, scale) => this.moved(D, scale), end: () => this.end() });
    view.overlay.add(this.outlines.group);
    store.on(["scenario"], ({ scenario }) => this.forget(scenario?.source ?? ""));
    store.on(["edits_pending"], ({ edits_pending }) => {
      this.settle();
      if (!edits_pending) for (const act of this.waiting.splice(0)) this.afterEdits(act);
    });
    store.on(["refused"], ({ refused }) => {
      if (refused?.overrides.some((each) => this.sent.has(each))) toast(refused.text);
    });
    store.on(["things"], ({ things, chosen }) => !things && chosen.length > 0 && store.set({ chosen: [] }));
    store.on(["model", "step_version", "chosen", "tool", "things", "viewpoint", "status", "link", "off"], () => this.refresh());
  }

  get chosen(): Thing[] {
    const { chosen } = this.store.state;
    return this.things.filter(({ key }) => chosen.includes(key));
  }

  /** Whether this page may change things. */
  get steers(): boolean {
    return hasPen(this.store.state) && this.store.state.scrub === null;
  }

  choose(key: string | null, more = false): void {
    const { chosen } = this.store.state;
    if (key === null) this.store.set({ chosen: [] });
    else if (!more) this.store.set({ chosen: [key], things: true });
    else this.store.set({ chosen: chosen.includes(key) ? chosen.filter((each) => each !== key) : [...chosen, key], things: true });
  }

  /** Let the next clicks do something else, null to choose again. */
  await(clicking: Clicking | null): void {
    this.clicking?.ended?.();
    this.clicking = clicking;
    this.refresh();
  }

  /** The table of an object in the model. */
  tableOf(object: string | null): Table | null {
    const objects = (this.store.state.model?.objects ?? []) as Table[];
    return objects.find(({ name }) => name === object) ?? null;
  }

  /** Value of a key, with what is on its way. */
  valueOf(key: string): unknown {
    return this.drafts.get(key) ?? valueAt(this.store.state.model, key);
  }

  /** Things under a pixel, points before all others, then the nearest first. */
  under(x: number, y: number): Met[] {
    const points = this.shown.filter(({ bounds }) => bounds.isEmpty());
    const near = points.flatMap((thing) => {
      const point = new Vector3().setFromMatrixPosition(this.local(thing));
      const px = this.view.pixel(point)?.distanceTo(new Vector2(x, y)) ?? Number.POSITIVE_INFINITY;
      return px <= NEAR_PX ? [{ key: thing.key, point, px }] : [];
    });
    const met: Met[] = [...near.sort((a, b) => a.px - b.px), ...this.outlines.under(this.view.ray(x, y))];
    return met.filter(({ key }, k) => met.findIndex((each) => each.key === key) === k);
  }

  /** Pose of a thing in the local frame of the scene. */
  local(thing: Thing): Matrix4 {
    return this.frame(FRAMES[thing.sort]).multiply(thing.T);
  }

  /** Pose of a frame of keys in the local frame of the scene. */
  frame(frame: Frame): Matrix4 {
    const { step } = this;
    const T = { ground: step?.T_world_ground, world: undefined, body: step?.T_world_body }[frame];
    return this.view.local(T ?? EYE);
  }

  get step(): StepMessage | null {
    return this.store.state.runs[0]?.shown ?? null;
  }

  /** Do something once the model is the server's: of a list that changes, it knows the numbers of all items. */
  afterEdits(act: () => void): void {
    if (this.store.state.edits_pending) this.waiting.push(act);
    else act();
  }

  /** Other values of keys, shown at once. */
  edit(changes: Iterable<readonly [string, number]>): void {
    const all = [...changes];
    for (const [key, value] of all) this.drafts.set(key, value);
    if (all.length) this.change(all.map(([key, value]) => override(key, value)));
    this.refresh();
  }

  /** Tell the server an edit, and the user why if it is refused. */
  readonly change = (overrides: readonly string[]): void => {
    if (!this.store.state.edits_pending) this.sent.clear();
    for (const each of overrides) this.sent.add(each);
    this.session.edit(overrides);
  };

  private get gripped(): Thing[] {
    return this.chosen.filter(({ placed }) => placed);
  }

  /** Frame in which what is chosen is moved. */
  get base(): Frame {
    return this.drag?.base ?? frameOf(this.gripped);
  }

  get isDragging(): boolean {
    return this.drag !== null;
  }

  begin(): void {
    const chosen = this.gripped;
    if (!chosen.length) return;
    const base = frameOf(chosen);
    const T_base_local = this.frame(base).invert();
    const parts = chosen.map((thing) => ({ thing, T_base: T_base_local.clone().multiply(this.local(thing)), before: new Map() }));
    this.drag = { base, parts };
  }

  /** All that is chosen is where D has taken it from where it was at the beginning. */
  moved(D: Matrix4, scale = new Vector3(1, 1, 1)): void {
    const { drag } = this;
    if (!drag) return;
    const T_local_base = this.frame(drag.base).multiply(D);
    const live: [string, number][] = [];
    for (const { thing, T_base, before } of drag.parts) {
      const now = new Map(before);
      const T = this.frame(FRAMES[thing.sort]).invert().multiply(T_local_base).multiply(T_base);
      for (const [key, value] of thing.changes(T, scale, !this.free && drag.parts.length === 1)) {
        if (!before.has(key)) before.set(key, Number(valueAt(this.store.state.model, key)));
        now.set(key, value);
      }
      for (const [key, value] of now) {
        if (isLive(thing) && this.drafts.get(key) !== value) live.push([key, value]);
        this.drafts.set(key, value);
      }
    }
    this.edit(live);
  }

  end(): void {
    const { drag } = this;
    this.drag = null;
    if (!drag) return;
    const late = drag.parts.filter(({ thing }) => !isLive(thing)).flatMap(({ before }) => [...before.keys()]);
    this.edit(late.map((key) => [key, this.drafts.get(key) ?? 0] as const));
    this.settle();
  }

  /** Draw all as it is now. */
  refresh(): void {
    const { model, chosen, tool, viewpoint } = this.store.state;
    this.things = model ? thingsOf(patched(model, this.drafts), model, this.view) : [];
    const drawn = viewpoint === "wall" ? [] : this.shown;
    this.outlines.show(drawn, (thing) => this.local(thing), new Set(chosen));
    this.view.label(
      "things",
      drawn.map((thing) => ({ at: this.labelled(thing), text: thing.title, colour: `#${COLOURS[thing.sort].toString(16)}` })),
    );
    this.grip(tool);
    this.view.redraw();
    for (const call of this.onChange) call();
  }

  /** The things that are drawn: all while they are listed, else those that are chosen; parts of others where one of these is chosen. */
  private get shown(): Thing[] {
    const { chosen, things } = this.store.state;
    const open = new Set(this.chosen.flatMap(({ key, partOf }) => [key, partOf]));
    const isShown = ({ key, partOf }: Thing) => (partOf === null ? things || chosen.includes(key) : open.has(partOf));
    return this.things.filter((thing) => thing.placed && isShown(thing));
  }

  private labelled({ bounds, ...thing }: Thing): Vector3 {
    const T = this.local({ bounds, ...thing });
    return new Vector3(0, 0, bounds.isEmpty() ? 0 : bounds.max.z).applyMatrix4(T);
  }

  private grip(tool: Tool): void {
    const chosen = this.gripped;
    const [first] = chosen;
    if (!first || !this.steers || this.clicking || this.store.state.viewpoint === "wall") {
      this.gizmo.hide();
      return;
    }
    const base = frameOf(chosen);
    const T_local_base = this.frame(base);
    if (chosen.length === 1) {
      this.gizmo.place(T_local_base, first.T, tool, first.axes[tool]);
      return;
    }
    const T_base_local = T_local_base.clone().invert();
    const middle = new Vector3();
    for (const thing of chosen) middle.add(new Vector3().setFromMatrixPosition(T_base_local.clone().multiply(this.local(thing))));
    middle.divideScalar(chosen.length);
    this.gizmo.place(T_local_base, new Matrix4().setPosition(middle), tool, { move: "XYZ", turn: "Z", scale: "" }[tool]);
  }

  /** The server has answered all: its model holds. */
  private settle(): void {
    if (this.drag || this.store.state.edits_pending || !this.drafts.size) return;
    this.drafts.clear();
    this.refresh();
  }

  private forget(source: string): void {
    this.drafts.clear();
    if (source === this.source) return;
    this.source = source;
    this.await(null);
    this.store.set({ chosen: [] });
  }
}

const NEAR_PX = 10; // of a point
const EYE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** That of all of them, or the ground's. */
function frameOf(things: readonly Thing[]): Frame {
  const [first, ...others] = new Set(things.map(({ sort }) => FRAMES[sort]));
  return first && !others.length ? first : "ground";
}

/** Whether a change acts at the next step, so that it is told while it is made. */
function isLive({ sort }: Thing): boolean {
  return sort === "function";
}
