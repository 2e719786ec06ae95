// Questions that take turns: the next one is sent once the last is answered, or after a while without an answer.

export class Turns {
  #sent: ReturnType<typeof setTimeout> | null = null;

  /** send: sends what is to be asked next; returns whether there was something. */
  constructor(
    private readonly send: () => boolean,
    private readonly patience_ms: number,
  ) {}

  /** Whether an answer is to come. */
  get waits(): boolean {
    return this.#sent !== null;
  }

  /** There is something to ask. */
  ask(): void {
    if (!this.waits && this.send()) this.#sent = setTimeout(() => this.answered(), this.patience_ms);
  }

  answered(): void {
    if (this.#sent !== null) clearTimeout(this.#sent);
    this.#sent = null;
    this.ask();
  }
}
