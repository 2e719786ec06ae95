// Grey pictures of the camera, whose codes are 255 times the root of the share of the most.

import type { Picture } from "../arrays.ts";

export interface Grey {
  width: number;
  height: number;
  /** `[height * width]`, 0..255. */
  codes: Uint8Array;
}

/** A picture of u1. */
export function grey({ shape: [height, width], values }: Picture): Grey {
  return { width, height, codes: values as Uint8Array };
}

/** Digital number of a code. */
export function digitalNumber(code: number, bits: number): number {
  return Math.round((code / 255) ** 2 * (2 ** bits - 1));
}

/** Grey to show of a difference of two codes, on minus off: `signed` around mid-grey, else what is darker than before is black. */
export function differenceTable(signed: boolean): Uint8ClampedArray {
  const table = new Uint8ClampedArray(65536);
  for (let on = 0; on < 256; on++) {
    for (let off = 0; off < 256; off++) {
      const share = (on * on - off * off) / (255 * 255);
      const root = Math.sign(share) * Math.sqrt(Math.abs(share));
      table[256 * on + off] = signed ? 127.5 * (1 + root) : 255 * root;
    }
  }
  return table;
}

/** An opaque grey image. */
export function painted(
  { width, height, codes }: Grey,
  colour: (code: number) => number = (code) => 0xff000000 | (code * 0x010101),
): OffscreenCanvas {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d") as OffscreenCanvasRenderingContext2D;
  const image = context.createImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const table = Uint32Array.from({ length: 256 }, (_, code) => colour(code) >>> 0);
  for (let k = 0; k < pixels.length; k++) pixels[k] = table[codes[k]];
  context.putImageData(image, 0, 0);
  return canvas;
}

/** On minus off of two pictures of one size, as `differenceTable` has it. */
export function difference(on: Grey, off: Grey, table: Uint8ClampedArray): Grey {
  const codes = new Uint8Array(on.codes.length);
  for (let k = 0; k < codes.length; k++) codes[k] = table[256 * on.codes[k] + off.codes[k]];
  return { ...on, codes };
}
