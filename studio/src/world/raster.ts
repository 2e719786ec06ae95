// Illuminances wanted on the road before the car, or on a wall before it, cell by cell.

/** What light can be wanted on, and where on its plane: least and largest x, least and largest y. Of the wall x is the height over the ground, y to the left. */
export const SURFACES = {
  road: { box_m: [0, 60, -10, 10], cell_m: 0.5 },
  wall: { box_m: [-3.5, 3.5, -12, 12], cell_m: 0.1 },
} as const;
export type Surface = keyof typeof SURFACES;

export class Raster {
  readonly box_m: readonly [number, number, number, number];
  readonly rows: number; // along x
  readonly cols: number; // along y
  readonly lx: Float32Array;
  readonly painted: Uint8Array;
  readonly #cell_m: number;

  constructor(readonly on: Surface) {
    const { box_m, cell_m } = SURFACES[on];
    this.box_m = box_m;
    this.#cell_m = cell_m;
    this.rows = Math.round((box_m[1] - box_m[0]) / cell_m);
    this.cols = Math.round((box_m[3] - box_m[2]) / cell_m);
    this.lx = new Float32Array(this.rows * this.cols);
    this.painted = new Uint8Array(this.rows * this.cols);
  }

  /** Want an illuminance in a circle, or nothing any more where it is null. */
  paint(x: number, y: number, radius_m: number, lx: number | null): void {
    for (let row = 0; row < this.rows; row++) {
      for (let col = 0; col < this.cols; col++) {
        const [dx, dy] = [this.box_m[0] + (row + 0.5) * this.#cell_m - x, this.box_m[2] + (col + 0.5) * this.#cell_m - y];
        if (dx * dx + dy * dy > radius_m * radius_m) continue;
        this.lx[row * this.cols + col] = lx ?? 0;
        this.painted[row * this.cols + col] = lx === null ? 0 : 1;
      }
    }
  }

  clear(): void {
    this.lx.fill(0);
    this.painted.fill(0);
  }
}
