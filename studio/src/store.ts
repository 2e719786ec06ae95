// One place for the page's state; views subscribe to keys of it.

export class Store<S extends object> {
  readonly #listeners = new Set<{ keys: ReadonlySet<keyof S>; call: (state: Readonly<S>) => void }>();
  readonly #changed = new Set<keyof S>();
  #state: S;

  constructor(state: S) {
    this.#state = state;
  }

  get state(): Readonly<S> {
    return this.#state;
  }

  /** Change some keys. Listeners are called before the next task, once for all that changed until then. */
  set(change: Partial<S>): void {
    for (const key of Object.keys(change) as (keyof S)[]) {
      if (Object.is(this.#state[key], change[key])) continue;
      if (this.#changed.size === 0) queueMicrotask(() => this.#tell());
      this.#changed.add(key);
    }
    this.#state = { ...this.#state, ...change };
  }

  /** Call a function now and after each change of one of the keys. Returns what ends the subscription. */
  on(keys: readonly (keyof S)[], call: (state: Readonly<S>) => void): () => void {
    const listener = { keys: new Set(keys), call };
    this.#listeners.add(listener);
    call(this.#state);
    return () => this.#listeners.delete(listener);
  }

  #tell(): void {
    const changed = new Set(this.#changed);
    this.#changed.clear();
    for (const { keys, call } of [...this.#listeners]) {
      if ([...changed].some((key) => keys.has(key))) call(this.#state);
    }
  }
}
