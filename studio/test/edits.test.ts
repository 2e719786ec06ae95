import assert from "node:assert/strict";
import { test } from "node:test";
import { Edits, inShort } from "../src/edits.ts";

function edits(): { edits: Edits; sent: string[][] } {
  const sent: string[][] = [];
  return { edits: new Edits((overrides) => sent.push(overrides)), sent };
}

test("one edit is on its way, and of later ones each key goes once, with its newest value", () => {
  const { edits: each, sent } = edits();
  each.add(["a.x=1"]);
  for (const override of ["a.x=2", "b=1", "a.x=3"]) each.add([override]);
  assert.deepEqual(sent, [["a.x=1"]]);
  assert.deepEqual(each.answered(), ["a.x=1"]);
  assert.deepEqual(sent[1], ["b=1", "a.x=3"]);
  each.answered();
  assert.equal(each.answered(), null);
  assert.equal(sent.length, 2);
});

test("a whole table takes the place of the keys in it, and keys after it stay", () => {
  const { edits: each, sent } = edits();
  each.add(["first=1"]);
  each.add(["a.x=1", "a[0].y=2", "ab=3", "a={}", "a.x=4"]);
  each.answered();
  assert.deepEqual(sent[1], ["ab=3", "a={}", "a.x=4"]);
});

test("a message has 100 overrides at most, and a cut connection forgets all", () => {
  const { edits: each, sent } = edits();
  each.add(Array.from({ length: 150 }, (_, k) => `k${k}=0`));
  assert.equal(sent[0].length, 100);
  each.answered();
  assert.equal(sent[1].length, 50);
  each.add(["z=1"]);
  each.clear();
  assert.equal(each.answered(), null);
  assert.equal(sent.length, 2);
});

test("edits in short are themselves, or their keys where they are long", () => {
  assert.equal(inShort(["seed=3", "a.x=1"]), "seed=3, a.x=1");
  assert.equal(inShort([`objects=[${"1, ".repeat(40)}]`, "functions.a.x_m=18.0"]), "objects, functions.a.x_m");
  const short = inShort(Array.from({ length: 20 }, (_, k) => `functions.a.key_${k}=${k}`));
  assert.match(short, /^(functions\.a\.key_\d+, )+functions\.a\.key_\d+ \.\.\.$/);
  assert.ok(short.length <= 74);
});
