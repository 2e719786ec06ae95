// What is painted on the pixels of one module.

/** Pixels from one row and column to others, which are not among them. */
export interface Box {
  top: number;
  bottom: number;
  left: number;
  right: number;
}

/** The least box that has both. */
export function both(one: Box | null, other: Box | null): Box | null {
  if (!one || !other) return one ?? other;
  return {
    top: Math.min(one.top, other.top),
    bottom: Math.max(one.bottom, other.bottom),
    left: Math.min(one.left, other.left),
    right: Math.max(one.right, other.right),
  };
}

export class Layer {
  /** Row by row, 255 for full utilisation. */
  readonly value: Uint8Array;
  /** Row by row, 255 where the value holds, 0 where nothing is painted. */
  readonly painted: Uint8Array;

  constructor(
    readonly rows: number,
    readonly cols: number,
  ) {
    this.value = new Uint8Array(rows * cols);
    this.painted = new Uint8Array(rows * cols);
  }

  get all(): Box {
    return { top: 0, bottom: this.rows, left: 0, right: this.cols };
  }

  /** Paint pixels by their numbers, or rub them out where the value is null. Returns the box that has changed. */
  paint(pixels: Iterable<number>, value: number | null): Box | null {
    const box = { top: this.rows, bottom: 0, left: this.cols, right: 0 };
    const painted = value === null ? 0 : 255;
    for (const pixel of pixels) {
      if (this.painted[pixel] === painted && (value === null || this.value[pixel] === value)) continue;
      this.painted[pixel] = painted;
      this.value[pixel] = value ?? 0;
      const row = Math.floor(pixel / this.cols);
      const col = pixel - row * this.cols;
      box.top = Math.min(box.top, row);
      box.bottom = Math.max(box.bottom, row + 1);
      box.left = Math.min(box.left, col);
      box.right = Math.max(box.right, col + 1);
    }
    return box.bottom > 0 ? box : null;
  }

  /** Another content. */
  replace(value: Uint8Array, painted: Uint8Array): void {
    this.value.set(value);
    this.painted.set(painted);
  }

  /** Values of a box, row by row. */
  cut(of: Uint8Array, { top, bottom, left, right }: Box): Uint8Array {
    const cut = new Uint8Array((bottom - top) * (right - left));
    for (let row = top; row < bottom; row++) {
      cut.set(of.subarray(row * this.cols + left, row * this.cols + right), (row - top) * (right - left));
    }
    return cut;
  }

  /** Utilisation 0..255 of a pixel, where u is what else gives it. */
  over(pixel: number, u: number, over: boolean): number {
    const share = this.painted[pixel] / 255;
    return Math.round(share * this.value[pixel] + (over ? (1 - share) * u : 0));
  }
}
