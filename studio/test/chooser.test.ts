import assert from "node:assert/strict";
import { test } from "node:test";
import { matching } from "../src/chooser.ts";

test("what has the words of a filter in its name comes before what has them in its description", () => {
  const items = [
    { name: "driving", description: "A night drive." },
    { name: "gfhb", description: "A high beam." },
    { name: "night_drive", description: "A way at night." },
  ];
  const names = (filter: string) => matching(items, filter).map(({ name }) => name);
  assert.deepEqual(names("night drive"), ["night_drive", "driving"]);
  assert.deepEqual(names(""), ["driving", "gfhb", "night_drive"]);
});
