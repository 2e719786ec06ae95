import assert from "node:assert/strict";
import { test } from "node:test";
import { defaults, groups, valuesOf } from "../src/curves/groups.ts";
import { places, stretch, thinned } from "../src/curves/thinned.ts";
import { Rows } from "../src/rows.ts";

const column = (name: string, unit = "") => ({ name, unit, description: "" });

test("rows gather by column beyond the first buffer, missing steps are NaN, and step 0 begins anew", () => {
  const rows = new Rows([column("a"), column("b")]);
  for (let step = 0; step < 3000; step++) rows.add(step, new Float32Array([step, -step]));
  assert.equal(rows.count, 3000);
  assert.equal(rows.at("a", 2999), 2999);
  assert.equal(rows.at("b", 1), -1);
  rows.add(3002, new Float32Array([1, 2]));
  assert.ok(Number.isNaN(rows.at("a", 3001)));
  assert.equal(rows.at("c", 0), Number.NaN);
  rows.add(0, new Float32Array([5, 6]));
  assert.equal(rows.count, 1);
});

test("the usual charts are of overlap, flux, objects and time, others one for each unit", () => {
  const columns = [
    column("step"),
    column("functions.symbol.iou", "1"),
    column("lamp.left.flux_lm", "lm"),
    column("objects.car.lx_max", "lx"),
    column("objects.car.confidence", "1"),
    column("plan_ms", "ms"),
    column("light_ms", "ms"),
    column("processing_ms", "ms"),
    column("functions.symbol.x_m", "m"),
  ];
  const names = defaults(columns);
  const found = groups(columns, names);
  assert.deepEqual(
    found.map(({ unit }) => unit),
    ["1", "lm", "lx", "1", "ms"],
  );
  assert.deepEqual(found[4].curves[1].columns, ["plan_ms", "light_ms"]);
  const rows = new Rows(columns);
  rows.add(0, new Float32Array([0, 1, 1, 1, 1, 2, 3, 4, 5]));
  assert.equal(valuesOf(found[4].curves[1], rows)(0), 5);
  assert.equal(groups(columns, new Set([...names, "functions.symbol.x_m"])).at(-1)?.title, "symbol.x_m");
});

test("thinning keeps every peak and gives as many values as places", () => {
  const peak = 12_345;
  const part = stretch(10, 60_010, 1200);
  const values = thinned((step) => (step === peak ? 100 : step === 777 ? Number.NaN : 0), part);
  assert.equal(values.length, places(part).length);
  assert.ok(values.length <= 1200);
  assert.equal(Math.max(...values.map(Number)), 100);
  const few = stretch(5, 8, 1200);
  assert.deepEqual(places(few), [5, 6, 7]);
  assert.deepEqual(
    thinned((step) => (step === 6 ? Number.NaN : step), few),
    [5, null, 7],
  );
});
