// Pixels of what is drawn on a grid: lines, regions and text. Places are in pixels, (0, 0) is the corner of the first.

export interface Grid {
  rows: number;
  cols: number;
}

export interface Place {
  row: number;
  col: number;
}

/** Numbers of the pixels of a line, as thick as it says; a thickness of 1 has one pixel a step. */
export function line({ rows, cols }: Grid, from: Place, to: Place, thickness: number): Set<number> {
  const found = new Set<number>();
  const add = (row: number, col: number) => {
    if (row >= 0 && row < rows && col >= 0 && col < cols) found.add(row * cols + col);
  };
  const steps = Math.ceil(2 * Math.max(Math.abs(to.row - from.row), Math.abs(to.col - from.col))) || 1;
  for (let k = 0; k <= steps; k++) {
    add(Math.floor(from.row + (k / steps) * (to.row - from.row)), Math.floor(from.col + (k / steps) * (to.col - from.col)));
  }
  if (thickness <= 1) return found;
  const radius = thickness / 2;
  const range = (a: number, b: number, most: number) => [
    Math.max(0, Math.floor(Math.min(a, b) - radius)),
    Math.min(most, Math.ceil(Math.max(a, b) + radius)),
  ];
  const [top, bottom] = range(from.row, to.row, rows);
  const [left, right] = range(from.col, to.col, cols);
  const along = { row: to.row - from.row, col: to.col - from.col };
  const length = along.row ** 2 + along.col ** 2;
  for (let row = top; row < bottom; row++) {
    for (let col = left; col < right; col++) {
      const at = { row: row + 0.5 - from.row, col: col + 0.5 - from.col };
      const share = length && Math.min(1, Math.max(0, (at.row * along.row + at.col * along.col) / length));
      if ((at.row - share * along.row) ** 2 + (at.col - share * along.col) ** 2 <= radius ** 2) add(row, col);
    }
  }
  return found;
}

/** Numbers of the pixels that hang together with one and are like it. */
export function region({ rows, cols }: Grid, from: number, alike: (one: number, other: number) => boolean): Int32Array {
  const found = new Int32Array(rows * cols);
  const seen = new Uint8Array(rows * cols);
  let count = 0;
  const add = (pixel: number) => {
    if (seen[pixel] || !alike(from, pixel)) return;
    seen[pixel] = 1;
    found[count++] = pixel;
  };
  add(from);
  for (let k = 0; k < count; k++) {
    const pixel = found[k];
    const col = pixel % cols;
    if (pixel >= cols) add(pixel - cols);
    if (pixel < (rows - 1) * cols) add(pixel + cols);
    if (col > 0) add(pixel - 1);
    if (col < cols - 1) add(pixel + 1);
  }
  return found.subarray(0, count);
}

/** Numbers of the pixels of a text whose lower left corner is at a place; its letters are so many rows high. */
export function text({ rows, cols }: Grid, at: Place, words: string, height: number): Set<number> {
  const font = `bold ${height}px system-ui, sans-serif`;
  const measure = new OffscreenCanvas(1, 1).getContext("2d") as OffscreenCanvasRenderingContext2D;
  measure.font = font;
  const width = Math.min(cols, Math.max(1, Math.ceil(measure.measureText(words).width)));
  const canvas = new OffscreenCanvas(width, Math.ceil(1.5 * height));
  const context = canvas.getContext("2d") as OffscreenCanvasRenderingContext2D;
  context.font = font;
  context.fillText(words, 0, height);
  const { data } = context.getImageData(0, 0, width, canvas.height);
  const found = new Set<number>();
  for (let k = 0; k < width * canvas.height; k++) {
    const [row, col] = [Math.floor(at.row) + 1 - height + Math.floor(k / width), Math.floor(at.col) + (k % width)];
    if (data[4 * k + 3] >= 128 && row >= 0 && row < rows && col >= 0 && col < cols) found.add(row * cols + col);
  }
  return found;
}
