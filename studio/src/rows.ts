// Values of all steps of a run, one growing buffer a column.

import type { Column } from "./protocol.ts";

export class Rows {
  readonly #buffers: Float32Array[];
  readonly #numbers: ReadonlyMap<string, number>;
  count = 0;

  constructor(readonly columns: readonly Column[]) {
    this.#buffers = columns.map(() => new Float32Array(1024));
    this.#numbers = new Map(columns.map(({ name }, number) => [name, number]));
  }

  /** Put in steps `first` and following, `values` row by row. Steps that never came are NaN; with step 0 a run begins anew. */
  add(first: number, values: Float32Array): void {
    const width = this.columns.length;
    if (width === 0) return;
    const steps = values.length / width;
    const end = first + steps;
    this.#buffers.forEach((buffer, column) => {
      if (end > buffer.length) {
        const larger = new Float32Array(Math.max(end, 2 * buffer.length));
        larger.set(buffer);
        buffer = this.#buffers[column] = larger;
      }
      if (first > this.count) buffer.fill(Number.NaN, this.count, first);
      for (let step = 0; step < steps; step++) buffer[first + step] = values[step * width + column];
    });
    this.count = first === 0 ? steps : Math.max(end, this.count);
  }

  /** Values of a column, one a step; null where the run has no such column. */
  column(name: string): Float32Array | null {
    const number = this.#numbers.get(name);
    return number === undefined ? null : this.#buffers[number].subarray(0, this.count);
  }

  /** Value of a column at a step, NaN without one. */
  at(name: string, step: number): number {
    const column = this.column(name);
    return column && step >= 0 && step < column.length ? column[step] : Number.NaN;
  }
}
