// What the page does with the server's messages, and what it asks of the server.

import type { Arrays } from "./arrays.ts";
import { Connection } from "./connection.ts";
import { download } from "./dom.ts";
import { Edits, inShort } from "./edits.ts";
import type { ClientMessage, MeshesMessage, ScenarioMessage, ServerMessage, StatusMessage, StepMessage, View } from "./protocol.ts";
import { hasPen, type PanelName, RunData, type Studio } from "./state.ts";

/** What the scenes are given, in the order in which it came. */
export interface SceneSink {
  begin(scenario: ScenarioMessage): void;
  /** Other facts of a run hold. */
  edited(run: number): void;
  meshes(message: MeshesMessage, arrays: Arrays): void;
  step(message: StepMessage, arrays: Arrays): void;
}

const VIEWS: Record<PanelName, View[]> = { scene: ["scene", "light"], camera: ["camera", "marks"], matrix: ["matrix"], curves: [] };
const ANSWER_MS = 3000; // a step that is shown already is not sent again
const SEEN = /^(lighting\.painted=|vehicle\.(course\[|roams=)|traffic\.drive=|steps=)/; // of what is painted and driven
const ALL: PanelName[] = ["scene", "camera", "matrix", "curves"];

export class Session {
  readonly #connection: Connection;
  readonly #edits = new Edits((overrides) => this.send({ type: "set", overrides }));
  /** The scrub that is not answered yet. The server answers the last one alone, so there is one at a time, and the runs take turns. */
  #asked: { run: number; step: number; timer: ReturnType<typeof setTimeout> } | null = null;
  /** By run, the step that the server has sent again last. */
  #answered: (number | null)[] = [];
  #wanted = "";
  /** The newest edit that is told as those of others are. */
  #told = "";

  constructor(
    address: { url: string; token: string },
    private readonly store: Studio,
    private readonly scenes: SceneSink,
    private readonly toast: (sentence: string, good?: boolean) => void,
  ) {
    this.#connection = new Connection(address.url, address.token, {
      link: (link) => {
        this.#edits.clear();
        this.store.set({ link, edits_pending: false });
      },
      message: (message, arrays) => this.#take(message, arrays),
      broken: toast,
    });
    store.on(["maximised", "link", "status", "pictures"], () => this.#want());
  }

  send(message: ClientMessage, arrays?: Arrays): void {
    if (this.store.state.link !== "open") {
      this.toast("There is no connection to the server.");
      return;
    }
    this.#connection.send(message, arrays);
  }

  /** Ask for what takes the pen; without it nothing happens. */
  steer(message: ClientMessage): void {
    if (hasPen(this.store.state)) this.send(message);
  }

  /**
   * Change values of keys, each `key=value`. For sliders and drags as well: an edit at a time is on its way, and then the newest values.
   * tell: from which step on they hold, where no control shows them.
   */
  edit(overrides: readonly string[], tell = false): void {
    if (tell) this.#told = overrides.join();
    if (this.store.state.link === "open") this.#edits.add(overrides);
    else this.toast("There is no connection to the server.");
    this.store.set({ edits_pending: this.#edits.pending });
  }

  /** The overrides of an edit that the server has answered, null where none was on its way. */
  #answer(): string[] | null {
    const overrides = this.#edits.answered();
    this.store.set({ edits_pending: this.#edits.pending });
    return overrides;
  }

  /** Whether an edit of a key, or of what it is in or has in it, is not answered yet. */
  isEditing(key: string): boolean {
    return this.#edits.has(key);
  }

  /** Look at a step again, or follow the newest. */
  scrub(step: number | null): void {
    this.store.set({ scrub: step });
    if (step !== null) {
      this.#ask();
      return;
    }
    this.#forget();
    this.send({ type: "scrub", run: 0, step: null });
  }

  #forget(): void {
    clearTimeout(this.#asked?.timer);
    this.#asked = null;
    this.#answered = [];
  }

  /** Ask for the step that is looked at, of a run that does not show it yet. */
  #ask(): void {
    const { scrub, runs } = this.store.state;
    if (this.#asked || scrub === null) return;
    const run = runs.findIndex((each, k) => this.#answered[k] !== scrub && scrub < each.rows.count);
    if (run < 0) return;
    const timer = setTimeout(() => {
      this.#asked = null;
      this.#answered[run] = scrub;
      this.#ask();
    }, ANSWER_MS);
    this.#asked = { run, step: scrub, timer };
    this.send({ type: "scrub", run, step: scrub });
  }

  #want(): void {
    const { maximised, link, status, pictures } = this.store.state;
    if (link !== "open") {
      this.#wanted = "";
      return;
    }
    const panels = maximised && status?.playing ? [maximised] : ALL; // a step at rest is sent once, and may be seen in all panels
    const views = panels.flatMap((panel) => [...VIEWS[panel], ...(panel === "camera" ? pictures : [])]);
    if (views.join() === this.#wanted) return;
    this.#wanted = views.join();
    this.#connection.send({ type: "want", views });
  }

  #take(message: ServerMessage, arrays: Arrays): void {
    const { store } = this;
    switch (message.type) {
      case "welcome":
        if (message.protocol !== 1) this.toast(`The server speaks protocol ${message.protocol}, this page 1: reload the page.`);
        this.#forget();
        store.set({ role: message.role, id: message.id, progress: null, status: null });
        return;
      case "error": {
        if (message.about === "scrub") this.#forget();
        if (message.about === "place" || message.about === "wish") store.set({ light: message });
        if (message.about === "meter") {
          store.set({ meter: message });
          return;
        }
        if (message.about === "drive") store.set({ driving: false });
        if (message.about === "paint") store.set({ answered: store.state.answered + 1 });
        const overrides = message.about === "set" || message.about === null ? this.#answer() : null;
        if (overrides) store.set({ refused: { overrides, text: message.text } });
        else this.toast(message.text);
        return;
      }
      case "progress":
        store.set({ progress: message.text });
        return;
      case "status":
        this.#tellRecording(store.state.status, message);
        store.set({ status: message });
        return;
      case "choices":
        store.set({ choices: message });
        return;
      case "scenario":
        this.#forget();
        this.#answer();
        this.#connection.send({ type: "scrub", run: 0, step: null });
        this.scenes.begin(message);
        store.set({
          scenario: message,
          model: message.model,
          runs: message.runs.map((_, run) => new RunData(message, run)),
          beams: message.runs.map(() => null),
          scrub: null,
          camera_run: Math.min(store.state.camera_run, message.runs.length - 1),
          matrix_run: Math.min(store.state.matrix_run, message.runs.length - 1),
        });
        return;
      case "meshes":
        this.scenes.meshes(message, arrays);
        return;
      case "step":
        try {
          this.#step(message, arrays);
        } finally {
          this.#connection.send({ type: "shown", id: message.id });
        }
        return;
      case "rows": {
        const { values, shape } = arrays.get("rows") ?? {};
        if (values instanceof Float32Array && shape) store.state.runs[message.run]?.rows.add(message.first, values, shape[1]);
        store.set({ rows_version: store.state.rows_version + 1 });
        return;
      }
      case "edit":
        this.#edited(message);
        if (message.run !== 0) return;
        store.set({ answered: store.state.answered + 1 });
        if ([undefined, this.#told].includes(this.#answer()?.join())) this.#tellEdit(message.step, message.overrides);
        return;
      case "schema":
        store.set({ schema: message.schema });
        return;
      case "saved":
        download(message.name, new Blob([message.text], { type: "application/toml" }));
        return;
      case "meter":
        store.set({ meter: message });
        return;
      case "place":
      case "wish":
        store.set({ light: message });
        return;
      case "summary": {
        const run = store.state.runs[message.run];
        if (run) run.summary = message.summary;
        store.set({ summary_version: store.state.summary_version + 1 });
        return;
      }
      case "beam": {
        const beams = [...store.state.beams];
        beams[message.run] = { rule: message.rule, side: message.side === "right" ? "right" : "left", points: message.points };
        store.set({ beams });
        return;
      }
    }
  }

  #edited({ run, model, facts }: Extract<ServerMessage, { type: "edit" }>): void {
    const { scenario, runs } = this.store.state;
    if (!scenario || !facts) return;
    const grown = facts.columns.length > scenario.runs[run].columns.length;
    Object.assign(scenario.runs[run], facts);
    runs[run].rows.grow(facts.columns);
    this.scenes.edited(run);
    if (run === 0 && model) Object.assign(scenario, { steps: model.steps, seed: model.seed });
    this.store.set({ ...(run === 0 && model && { model }), ...(grown && { scenario: { ...scenario } }) });
  }

  /** Of values that this page has not set: neither what is seen, nor what was before this page, nor what a recording repeats. */
  #tellEdit(step: number, overrides: readonly string[]): void {
    const count = this.store.state.runs[0]?.rows.count ?? 0;
    const told = overrides.filter((each) => !SEEN.test(each));
    if (told.length > 0 && count > 0 && count <= step) this.toast(`From step ${step} on: ${inShort(told)}`, true);
  }

  #tellRecording(before: StatusMessage | null, { recording }: StatusMessage): void {
    if (!before || before.recording === recording) return;
    this.toast(recording ? `Recording into runs/${recording}` : `Recorded in runs/${before.recording}`, true);
  }

  #step(message: StepMessage, arrays: Arrays): void {
    const { state } = this.store;
    const run = state.runs[message.run];
    if (!run) return;
    this.scenes.step(message, arrays);
    const { camera, matrix } = run.take(message, arrays);
    this.store.set({
      step_version: state.step_version + 1,
      ...(camera && { camera_version: state.camera_version + 1 }),
      ...(matrix && { matrix_version: state.matrix_version + 1 }),
    });
    if (!message.scrub || this.#asked?.run !== message.run) return;
    clearTimeout(this.#asked.timer);
    this.#answered[message.run] = this.#asked.step;
    this.#asked = null;
    this.#ask();
  }
}
