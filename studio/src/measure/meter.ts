// The server's light meter: one question at a time, of each asker the newest, and while the loop runs with rests between them.

import type { MeterRequest, Reading } from "../protocol.ts";
import type { Session } from "../session.ts";
import type { Studio } from "../state.ts";
import { Turns } from "../turns.ts";

const PATIENCE_MS = 10_000;
const REST = 3; // times what an answer took, for which a running loop is left alone

/** Rays of sight in a run; see MeterRequest. */
export type Sight = Required<Pick<MeterRequest, "run" | "on" | "eye_m" | "through_m" | "side">>;
/** What to do with the readings, or with the reason why there are none. */
export type Answered = (readings: readonly (Reading | null)[], refused: string | null) => void;

interface Question {
  sight: () => Sight | null;
  answered: Answered;
}

export class Meter {
  readonly #waiting = new Map<string, Question>();
  readonly #turns: Turns;
  #asked: Question | null = null;
  #asked_ms = 0;
  #resting = false;

  constructor(
    private readonly store: Studio,
    private readonly session: Session,
  ) {
    this.#turns = new Turns(() => this.#send(), PATIENCE_MS);
    store.on(["link"], () => this.#turns.answered());
    store.on(["meter"], ({ meter, status }) => {
      const asked = this.#asked;
      if (!meter || !asked) return;
      this.#asked = null;
      if (meter.type === "meter") asked.answered(meter.readings, null);
      else asked.answered([], meter.text);
      const rest_ms = status?.playing ? REST * (performance.now() - this.#asked_ms) : 0;
      this.#resting = rest_ms > 0;
      if (this.#resting) setTimeout(() => this.#rested(), rest_ms);
      this.#turns.answered();
    });
  }

  /** sight: where to look when the question is sent, null nowhere any more. who: asks in place of its last question that still waits. */
  ask(who: string, sight: () => Sight | null, answered: Answered): void {
    this.#waiting.set(who, { sight, answered });
    this.#turns.ask();
  }

  #rested(): void {
    this.#resting = false;
    this.#turns.ask();
  }

  #send(): boolean {
    if (this.#resting || this.store.state.link !== "open") return false;
    for (const [who, question] of this.#waiting) {
      this.#waiting.delete(who);
      const sight = question.sight();
      const shown = sight && this.store.state.runs[sight.run]?.shown;
      if (!sight || !shown) continue;
      this.#asked = question;
      this.#asked_ms = performance.now();
      this.session.send({ type: "meter", step: shown.step, ...sight });
      return true;
    }
    return false;
  }
}
