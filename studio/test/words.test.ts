import assert from "node:assert/strict";
import { test } from "node:test";
import { flat } from "../src/flat.ts";
import { Store } from "../src/store.ts";
import { words } from "../src/words.ts";

test("keys are split at spaces, but not within quotation marks and brackets", () => {
  assert.deepEqual(words("  road.kind=bumps camera.bits=10 "), ["road.kind=bumps", "camera.bits=10"]);
  assert.deepEqual(words('a.start={ x_m = 1, y = [1, 2] } b="two words" c=1'), ["a.start={ x_m = 1, y = [1, 2] }", 'b="two words"', "c=1"]);
});

test("a summary becomes paths with values", () => {
  assert.deepEqual(flat({ steps: 40, lamps: { left: { on: true } }, error: [0.25, null], objects: {} }), [
    ["steps", "40"],
    ["lamps.left.on", "yes"],
    ["error", "0.25, -"],
  ]);
});

test("subscribers are called at once, and then once for all that has changed of their keys", async () => {
  const store = new Store({ a: 1, b: 1, c: 1 });
  const seen: number[] = [];
  const end = store.on(["a", "b"], ({ a, b }) => seen.push(a + b));
  store.set({ a: 2 });
  store.set({ b: 3 });
  store.set({ c: 9 });
  await Promise.resolve();
  store.set({ a: 2 });
  await Promise.resolve();
  end();
  store.set({ a: 7 });
  await Promise.resolve();
  assert.deepEqual(seen, [2, 5]);
});
