// Values of all steps of a run, one growing buffer a column.

import type { Column } from "./protocol.ts";

export class Rows {
  readonly #buffers: Float32Array[] = [];
  readonly #numbers = new Map<string, number>();
  count = 0;

  constructor(columns: readonly Column[]) {
    this.grow(columns);
  }

  /** Take further columns, which have no values so far. */
  grow(columns: readonly Column[]): void {
    for (const { name } of columns.slice(this.#buffers.length)) {
      this.#numbers.set(name, this.#buffers.length);
      this.#buffers.push(new Float32Array(Math.max(1024, this.count)).fill(Number.NaN));
    }
  }

  /** Put in steps `first` and following, `values` row by row, `width` each. What never came is NaN; with step 0 a run begins anew. */
  add(first: number, values: Float32Array, width = this.#buffers.length): void {
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
      for (let step = 0; step < steps; step++) buffer[first + step] = column < width ? values[step * width + column] : Number.NaN;
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
