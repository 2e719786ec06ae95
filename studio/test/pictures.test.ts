import assert from "node:assert/strict";
import { test } from "node:test";
import { difference, differenceTable, digitalNumber } from "../src/camera/picture.ts";
import { layout } from "../src/matrix/layout.ts";

test("codes are the root of digital numbers", () => {
  assert.equal(digitalNumber(255, 12), 4095);
  assert.equal(digitalNumber(0, 12), 0);
  assert.equal(digitalNumber(128, 8), Math.round((128 / 255) ** 2 * 255));
});

test("a difference is grey or black where nothing differs, and keeps its sign", () => {
  const [on, off] = [
    { width: 3, height: 1, codes: new Uint8Array([200, 100, 0]) },
    { width: 3, height: 1, codes: new Uint8Array([200, 0, 255]) },
  ];
  const signed = difference(on, off, differenceTable(true)).codes;
  assert.equal(Math.abs(signed[0] - 127.5), 0.5);
  assert.ok(signed[1] > 170 && signed[2] === 0);
  assert.deepEqual([...difference(on, off, differenceTable(false)).codes], [0, 100, 0]);
});

test("modules lie on their lamp's side, in proportion, and in columns where there are many", () => {
  const module = (side: "left" | "right", half: number) => ({
    name: "",
    side,
    rows: 2,
    cols: 2,
    left: half,
    right: -half,
    bottom: -half / 4,
    top: half / 4,
    pixel_rows: 10,
    pixel_cols: 40,
    peak_cd: 1,
    flux_lm: 1,
  });
  const { tiles, width, height } = layout([module("left", 0.8), module("left", 0.4), module("right", 0.8)]);
  const [wide, narrow, right] = tiles;
  assert.equal(narrow.width, wide.width / 2);
  assert.equal(narrow.height, wide.height / 2);
  assert.ok(narrow.y >= wide.y + wide.height);
  assert.ok(right.x >= wide.x + wide.width);
  assert.ok(tiles.every((each) => each.x + each.width <= width && each.y + each.height <= height));
  const many = layout(Array.from({ length: 12 }, (_, k) => module(k % 2 ? "right" : "left", 0.8)));
  assert.ok(many.width / many.height > 1.2 && many.width / many.height < 5);
  assert.deepEqual(
    many.tiles.map((each) => each.module).sort((a, b) => a - b),
    [...Array(12).keys()],
  );
});
