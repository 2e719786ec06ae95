// Illuminances wanted on the ground before the car, cell by cell.

export const BOX_M = [0, 60, -10, 10] as const; // least and largest x, least and largest y, of the ground's frame
const CELL_M = 0.5;

export class Raster {
  readonly rows = (BOX_M[1] - BOX_M[0]) / CELL_M; // along x
  readonly cols = (BOX_M[3] - BOX_M[2]) / CELL_M; // along y
  readonly lx = new Float32Array(this.rows * this.cols);
  readonly painted = new Uint8Array(this.rows * this.cols);

  /** Want an illuminance in a circle, or nothing any more where it is null. */
  paint(x: number, y: number, radius_m: number, lx: number | null): void {
    for (let row = 0; row < this.rows; row++) {
      for (let col = 0; col < this.cols; col++) {
        const [dx, dy] = [BOX_M[0] + (row + 0.5) * CELL_M - x, BOX_M[2] + (col + 0.5) * CELL_M - y];
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
