import assert from "node:assert/strict";
import { test } from "node:test";
import { csv, readCsv } from "../src/matrix/files.ts";
import { Layer } from "../src/matrix/layer.ts";
import { line, region } from "../src/matrix/raster.ts";

const GRID = { rows: 20, cols: 30 };
const at = (row: number, col: number) => row * GRID.cols + col;

test("a thin line has a pixel a step and no gaps, in every direction", () => {
  for (const to of [
    { row: 5.5, col: 25.5 },
    { row: 15.2, col: 3.9 },
    { row: 0.5, col: 10.5 },
  ]) {
    const pixels = [...line(GRID, { row: 5.5, col: 10.5 }, to, 1)];
    const steps = Math.max(Math.abs(Math.floor(to.row) - 5), Math.abs(Math.floor(to.col) - 10));
    assert.ok(pixels.includes(at(5, 10)) && pixels.includes(at(Math.floor(to.row), Math.floor(to.col))));
    assert.ok(pixels.length > steps && pixels.length <= 2 * steps + 1);
    pixels.slice(1).forEach((pixel, k) => {
      const [a, b] = [pixels[k], pixel];
      assert.ok(Math.abs(Math.floor(a / 30) - Math.floor(b / 30)) <= 1 && Math.abs((a % 30) - (b % 30)) <= 1);
    });
  }
});

test("a thick line is as thick as it says, and ends at the borders", () => {
  const level = line(GRID, { row: 10, col: 5 }, { row: 10, col: 20 }, 4);
  for (let row = 0; row < 20; row++) assert.equal(level.has(at(row, 12)), row >= 8 && row < 12);
  const outside = line(GRID, { row: -50, col: -50 }, { row: 50, col: 80 }, 3);
  assert.ok(outside.size > 0 && [...outside].every((pixel) => pixel >= 0 && pixel < 600));
  assert.equal(line(GRID, { row: -5, col: 3 }, { row: -4, col: 9 }, 1).size, 0);
});

test("a region is what hangs together and is alike", () => {
  const layer = new Layer(20, 30);
  layer.paint(line(layer, { row: 0.5, col: 14.5 }, { row: 19.5, col: 14.5 }, 1), 200);
  const alike = (one: number, other: number) => layer.painted[one] === layer.painted[other];
  assert.equal(region(layer, at(3, 3), alike).length, 20 * 14);
  assert.equal(region(layer, at(3, 20), alike).length, 20 * 15);
  assert.equal(region(layer, at(0, 14), alike).length, 20);
});

test("a layer tells what has changed, and mixes with what lies below", () => {
  const layer = new Layer(3, 28);
  assert.deepEqual(layer.paint([2 * 28 + 5, 28 + 9], 100), { top: 1, bottom: 3, left: 5, right: 10 });
  assert.equal(layer.paint([28 + 9], 100), null);
  assert.deepEqual([layer.over(28 + 9, 7, true), layer.over(28 + 9, 7, false)], [100, 100]);
  assert.deepEqual([layer.over(0, 7, true), layer.over(0, 7, false)], [7, 0]);
  assert.deepEqual(layer.cut(layer.value, { top: 1, bottom: 3, left: 8, right: 10 }), new Uint8Array([0, 100, 0, 0]));
  assert.deepEqual(layer.paint([28 + 9], null), { top: 1, bottom: 2, left: 9, right: 10 });
});

test("a table comes back as it was written, and what is wrong in one is named", () => {
  const u = Uint8Array.from({ length: 256 }, (_, code) => code);
  assert.deepEqual(readCsv("u.csv", csv(u, 32)).value, u);
  const { rows, cols, value, painted } = readCsv("u.csv", "0,5;;1\n0,2;0;0\n");
  assert.deepEqual([rows, cols, [...value], [...painted]], [2, 3, [128, 0, 255, 51, 0, 0], [255, 0, 255, 255, 255, 255]]);
  assert.throws(() => readCsv("u.csv", "0,1\n0,2"), /u\.csv: 2 in row 1, column 1 is not from 0 to 1/);
  assert.throws(() => readCsv("u.csv", "0,1\n0"), /row 1 has 1 values and row 0 has 2/);
  assert.throws(() => readCsv("u.csv", ""), /no lines/);
});
