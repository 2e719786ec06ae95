// Pictures of a module's pixels in files: PNG and CSV, never of another size.

export interface Pixels {
  rows: number;
  cols: number;
  /** Row by row, 255 for full utilisation. */
  value: Uint8Array;
  /** Row by row, 255 where the value holds. */
  painted: Uint8Array;
}

/** The content of a picture's file. Rejects with an Error that says what is wrong with it. */
export async function readPixels(file: File): Promise<Pixels> {
  if (/\.csv$/i.test(file.name)) return readCsv(file.name, await file.text());
  if (!/\.png$/i.test(file.name)) throw new Error(`${file.name}: pictures of pixels are .png and .csv files; save it as one of these`);
  return readPng(file, file.name);
}

/** The content of a PNG: grey values, and what is opaque. */
export async function readPng(file: Blob, name: string): Promise<Pixels> {
  let bitmap: ImageBitmap;
  try {
    bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch {
    throw new Error(`${name}: holds no picture; save it as PNG`);
  }
  const { width: cols, height: rows } = bitmap;
  const context = new OffscreenCanvas(cols, rows).getContext("2d") as OffscreenCanvasRenderingContext2D;
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  const { data } = context.getImageData(0, 0, cols, rows);
  const pixels = { rows, cols, value: new Uint8Array(rows * cols), painted: new Uint8Array(rows * cols) };
  for (let k = 0; k < rows * cols; k++) {
    pixels.value[k] = Math.round(0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2]);
    pixels.painted[k] = data[4 * k + 3];
  }
  return pixels;
}

/** The content of a CSV: a line a row, utilisations from 0 to 1, nothing where nothing is painted. */
export function readCsv(name: string, text: string): Pixels {
  const lines = text.split(/\r?\n/).filter((line) => line !== "");
  const separator = [";", "\t", ","].find((each) => lines.some((line) => line.includes(each))) ?? ",";
  const cells = lines.map((line) => line.split(separator).map((cell) => cell.trim()));
  const [rows, cols] = [cells.length, cells[0]?.length ?? 0];
  if (rows === 0) throw new Error(`${name}: holds no lines; give a line for each row of pixels`);
  const pixels = { rows, cols, value: new Uint8Array(rows * cols), painted: new Uint8Array(rows * cols) };
  cells.forEach((line, row) => {
    if (line.length !== cols) throw new Error(`${name}: row ${row} has ${line.length} values and row 0 has ${cols}; give all rows as many`);
    line.forEach((cell, col) => {
      if (cell === "") return;
      const share = Number(separator === "," ? cell : cell.replace(",", "."));
      if (!(share >= 0 && share <= 1)) throw new Error(`${name}: ${cell} in row ${row}, column ${col} is not from 0 to 1`);
      pixels.value[row * cols + col] = Math.round(255 * share);
      pixels.painted[row * cols + col] = 255;
    });
  });
  return pixels;
}

/** Utilisations 0..255 as CSV: a line a row, values from 0 to 1. */
export function csv(u: Uint8Array, cols: number): string {
  const lines: string[] = [];
  for (let first = 0; first < u.length; first += cols) {
    lines.push(Array.from(u.subarray(first, first + cols), (code) => String(Math.round((1e4 * code) / 255) / 1e4)).join(","));
  }
  return `${lines.join("\n")}\n`;
}

/** Utilisations 0..255 as a grey PNG. */
export function png(u: Uint8Array, cols: number): Promise<Blob> {
  const canvas = new OffscreenCanvas(cols, u.length / cols);
  const image = new ImageData(cols, u.length / cols);
  new Uint32Array(image.data.buffer).set(Uint32Array.from(u, (code) => (0xff000000 | (code * 0x010101)) >>> 0));
  (canvas.getContext("2d") as OffscreenCanvasRenderingContext2D).putImageData(image, 0, 0);
  return canvas.convertToBlob({ type: "image/png" });
}
