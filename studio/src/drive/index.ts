// Somebody drives: keyboard and gamepad steer the car, and its light switch the base beam.

import { confirm } from "../dialog.ts";
import { h } from "../dom.ts";
import type { StepMessage } from "../protocol.ts";
import type { ScenesPanel } from "../scenes/panel.ts";
import type { Session } from "../session.ts";
import { hasPen, needsPen, type Studio } from "../state.ts";
import { type Controls, isControl, ofKeys, ofPads, shoulders, turned } from "./controls.ts";
import { IndicatorSwitch } from "./indicator.ts";
import { ModuleSliders } from "./modules.ts";

const TICK_MS = 50;
const WHEELS = "vehicle.course=[{speed_m_s=0.0}]";
const BEAMS = ["off", "low", "auto", "high"] as const;
type Beam = (typeof BEAMS)[number];
const FLASH = "KeyF";
const HOW = "Drive the car with arrow keys, W, A, S and D, or a gamepad; Escape ends it";

export const DRIVE_KEYS: [string, string][] = [
  ["Arrow keys, WASD", "while you drive: accelerate, brake, steer"],
  ["l, h, f", "while you drive: light switch (off, low, auto), high beam, flash"],
  ["q, e, x", "while you drive: indicator left, right, hazard lights; again: off"],
];

export function driveControls(store: Studio, session: Session, scenes: ScenesPanel): void {
  new Driving(store, session, scenes);
}

class Driving {
  readonly #down = new Set<string>();
  readonly #button = h("button", { class: "toggle", title: HOW, onclick: () => this.#flip() }, "Drive");
  readonly #speed = h("output", { class: "drive-speed" });
  readonly #wheel = h("span", { class: "drive-wheel" }, h("i"));
  readonly #light = h("span", { class: "segments", role: "group", "aria-label": "Light switch" });
  readonly #hud = h("div", { class: "drive-hud", hidden: true }, this.#speed, this.#wheel, this.#light);
  readonly #indicator: IndicatorSwitch;
  /** Shoulder buttons of gamepads at the last tick. */
  #shoulders = { left: false, right: false };
  #timer: ReturnType<typeof setInterval> | null = null;
  #sent: Controls = { throttle: 0, steering: 0 };
  #steering = 0;
  /** What the session ran at before. */
  #factor: number | null = null;
  /** The beam before the flash. */
  #before: Beam | null = null;
  #last: StepMessage | null = null;
  /** Whether driving begins once the car is on wheels. */
  #due = false;

  constructor(
    private readonly store: Studio,
    private readonly session: Session,
    scenes: ScenesPanel,
  ) {
    this.#light.append(
      ...BEAMS.map((beam) => h("button", { class: "toggle", title: TITLES[beam], onclick: () => this.#switch(beam) }, beam)),
    );
    this.#indicator = new IndicatorSwitch(store, session);
    this.#hud.append(this.#indicator.element, new ModuleSliders(store, session).element);
    scenes.bar.append(this.#button);
    scenes.body.append(this.#hud);
    store.on(["driving"], ({ driving }) => this.#show(driving));
    needsPen(store, this.#button);
    store.on(["link", "status", "id", "model"], (state) => this.#refresh(hasPen(state)));
    store.on(["runs"], () => {
      this.#end(); // of runs that start anew
      if (this.#due && store.state.model?.vehicle) this.#begin();
    });
    store.on(["refused"], () => (this.#due = false));
    store.on(["step_version"], () => this.#tell());
    document.addEventListener("keydown", (event) => this.#key(event, true), { capture: true });
    document.addEventListener("keyup", (event) => this.#key(event, false), { capture: true });
    addEventListener("blur", () => this.#release());
  }

  #flip(): void {
    const { driving, model } = this.store.state;
    if (driving) this.#end();
    else if (model?.vehicle) this.#begin();
    else this.#putOnWheels();
  }

  #putOnWheels(): void {
    const { status } = this.store.state;
    const ends = status?.recording ? ` The recording into runs/${status.recording} ends.` : "";
    confirm("The car stands in this scenario", `To drive, it is put on wheels. The run starts anew.${ends}`, "Put it on wheels", () => {
      this.#due = true;
      this.session.edit([WHEELS]);
    });
  }

  #begin(): void {
    const { status } = this.store.state;
    this.#due = false;
    this.#factor = status?.speed ?? null;
    if (this.#factor === null || this.#factor > 1) this.session.send({ type: "speed", factor: 1 });
    this.#sent = { throttle: 0, steering: 0 };
    this.#steering = 0;
    this.session.scrub(null);
    this.session.send({ type: "drive", ...this.#sent });
    if (!status?.playing) this.session.send({ type: "play" });
    this.store.set({ driving: true, viewpoint: "driver" });
    this.#button.blur(); // which the space bar would press
  }

  #end(): void {
    const { state } = this.store;
    if (!state.driving) return;
    this.store.set({ driving: false });
    if (!hasPen(state)) return;
    this.session.send({ type: "drive", throttle: null, steering: null });
    if (state.status?.speed !== this.#factor) this.session.send({ type: "speed", factor: this.#factor });
  }

  #show(driving: boolean): void {
    this.#hud.hidden = !driving;
    this.#speed.textContent = driving ? this.#speed.textContent || kmh(this.#initial()) : "";
    this.#button.setAttribute("aria-pressed", String(driving));
    this.#release();
    if (this.#timer !== null) clearInterval(this.#timer);
    this.#timer = driving ? setInterval(() => this.#tick(), TICK_MS) : null;
  }

  #refresh(steers: boolean): void {
    if (!steers && this.store.state.driving) this.store.set({ driving: false });
    const beam = this.#beam();
    BEAMS.forEach((each, k) => this.#light.children[k].setAttribute("aria-pressed", String(each === beam)));
  }

  #tick(): void {
    const keys = ofKeys(this.#down);
    const pads = navigator.getGamepads?.() ?? [];
    const pad = this.#down.size ? null : ofPads(pads);
    const buttons = shoulders(pads);
    for (const side of ["left", "right"] as const) if (buttons[side] && !this.#shoulders[side]) this.#indicator.press(side);
    this.#shoulders = buttons;
    this.#steering = pad ? pad.steering : turned(this.#steering, keys.steering, TICK_MS / 1000);
    const now = { throttle: round(pad ? pad.throttle : keys.throttle), steering: round(this.#steering) };
    (this.#wheel.firstElementChild as HTMLElement).style.left = `${50 - 45 * now.steering}%`;
    if (now.throttle === this.#sent.throttle && now.steering === this.#sent.steering) return;
    this.#sent = now;
    this.session.send({ type: "drive", ...now });
  }

  #key(event: KeyboardEvent, down: boolean): void {
    if (!this.store.state.driving || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target instanceof Element && event.target.closest("dialog, .popover, input:not([type=range], [type=checkbox]), textarea"))
      return;
    const acts: Record<string, () => void> = {
      Escape: () => this.#end(),
      KeyL: () => this.#switch(BEAMS[(BEAMS.indexOf(this.#beam() ?? "off") + 1) % 3]),
      KeyH: () => this.#switch(this.#beam() === "high" ? "low" : "high"),
    };
    if (isControl(event.code)) {
      if (down) this.#down.add(event.code);
      else this.#down.delete(event.code);
    } else if (event.code === FLASH) this.#flash(down);
    else {
      const act = acts[event.code] ?? this.#indicator.ofKey(event.code);
      if (!act) return;
      if (down && !event.repeat) act();
    }
    event.preventDefault();
    event.stopPropagation();
  }

  /** All keys, whose going up is not seen from now on. */
  #release(): void {
    this.#down.clear();
    this.#flash(false);
  }

  /** High beam as long as the key is down. */
  #flash(down: boolean): void {
    if (down && this.#before === null) {
      this.#before = this.#beam();
      this.#switch("high");
    } else if (!down && this.#before !== null) {
      this.#switch(this.#before);
      this.#before = null;
    }
  }

  #beam(): Beam | null {
    const lighting = this.store.state.model?.lighting as { base: { beam: Beam } } | undefined;
    return lighting?.base.beam ?? null;
  }

  #switch(beam: Beam): void {
    this.session.edit([`lighting.base.beam="${beam}"`]);
  }

  /** Speed in m/s that the car has before a step tells it. */
  #initial(): number {
    const vehicle = this.store.state.model?.vehicle as { course: { speed_m_s: number }[] } | null | undefined;
    return vehicle?.course[0]?.speed_m_s ?? 0;
  }

  /** Speed between the last two steps that came. */
  #tell(): void {
    const { shown } = this.store.state.runs[0] ?? {};
    const last = this.#last;
    if (!shown || shown === last) return;
    this.#last = shown;
    if (!last || shown.time_s <= last.time_s) return;
    const way_m = Math.hypot(shown.T_world_ground[3] - last.T_world_ground[3], shown.T_world_ground[7] - last.T_world_ground[7]);
    this.#speed.textContent = kmh(way_m / (shown.time_s - last.time_s));
  }
}

const TITLES: Record<Beam, string> = {
  off: "No base beam: the light of the functions alone",
  low: "Low beam (l)",
  auto: "The beam that speed, rain and street lighting ask for (l)",
  high: "High beam (h); f flashes",
};

function kmh(speed_m_s: number): string {
  return `${(3.6 * speed_m_s).toFixed(0)} km/h`;
}

function round(share: number): number {
  return Math.round(100 * share) / 100;
}
