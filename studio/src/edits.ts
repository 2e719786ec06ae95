// Edits of the scenario on their way: one at a time, and what came meanwhile after it, each key with its newest value.

const MOST = 100; // overrides of a message
const LETTERS = 70; // of edits in short

export class Edits {
  #sent: string[] | null = null;
  readonly #waiting = new Map<string, string>();

  constructor(private readonly send: (overrides: string[]) => void) {}

  /** Take overrides `key=value`: at once if no other edit is on its way, else after its answer. */
  add(overrides: readonly string[]): void {
    for (const override of overrides) {
      const key = keyOf(override);
      for (const earlier of [...this.#waiting.keys()]) if (isWithin(earlier, key)) this.#waiting.delete(earlier);
      this.#waiting.set(key, override);
    }
    this.#next();
  }

  /** The server has answered. Returns the overrides that it answered, null where none were on their way. */
  answered(): string[] | null {
    const sent = this.#sent;
    this.#sent = null;
    this.#next();
    return sent;
  }

  /** Whether an edit of a key, or of what it is in or has in it, is not answered yet. */
  has(key: string): boolean {
    const all = [...(this.#sent ?? []), ...this.#waiting.values()].map(keyOf);
    return all.some((each) => isWithin(each, key) || isWithin(key, each));
  }

  /** Whether edits are on their way or wait for that. */
  get pending(): boolean {
    return this.#sent !== null || this.#waiting.size > 0;
  }

  /** Forget all: the connection is cut. */
  clear(): void {
    this.#sent = null;
    this.#waiting.clear();
  }

  #next(): void {
    if (this.#sent || this.#waiting.size === 0) return;
    const next = [...this.#waiting].slice(0, MOST);
    for (const [key] of next) this.#waiting.delete(key);
    this.#sent = next.map(([, override]) => override);
    this.send(this.#sent);
  }
}

/** Key of an override `key=value`. */
export function keyOf(override: string): string {
  return override.split("=", 1)[0].trim();
}

/** Whether a key is another one, or lies in that one's table or list. */
export function isWithin(key: string, other: string): boolean {
  return key === other || key.startsWith(`${other}.`) || key.startsWith(`${other}[`);
}

/** Edits in short: as they are, or their keys where that is too long. */
export function inShort(overrides: readonly string[]): string {
  const whole = overrides.join(", ");
  if (whole.length <= LETTERS) return whole;
  const keys = [...new Set(overrides.map(keyOf))].join(", ");
  return keys.length <= LETTERS ? keys : `${keys.slice(0, LETTERS).replace(/,[^,]*$/, "")} ...`;
}
