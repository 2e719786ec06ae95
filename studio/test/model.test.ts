import assert from "node:assert/strict";
import { test } from "node:test";
import { span, stepFor, stepOf, unitOf } from "../src/model/numbers.ts";
import { override, part, toml, valueAt } from "../src/model/overrides.ts";
import { told } from "../src/model/refused.ts";
import { actsOf } from "../src/model/row.ts";
import { type Schema, Schemas, same } from "../src/model/schema.ts";
import { search } from "../src/model/search.ts";

const gains: Schema = {
  type: "object",
  properties: { kp: { type: "number", minimum: -1e6, maximum: 1e6, description: "proportional gain", examples: [0.3] } },
};
const root: Schema = {
  $defs: {
    Flat: { type: "object", description: "Flat.", properties: { kind: { const: "flat", default: "flat" } } },
    Step: {
      type: "object",
      properties: { kind: { const: "step", default: "step" }, x_m: { type: "number", minimum: 0, maximum: 50, default: 20 } },
    },
    Own: { type: "object", properties: { kind: { type: "string" } } },
    Gains: gains,
    Walker: {
      type: "object",
      properties: {
        name: { type: "string", examples: ["walker"] },
        track: { type: "array", items: { $ref: "#/$defs/Lamp" }, default: [] },
      },
    },
    Lamp: {
      type: "object",
      properties: { position_m: { type: "array", prefixItems: [{ type: "number" }, { type: "number" }], examples: [[20, 5]] } },
    },
  },
  type: "object",
  properties: {
    bits: { type: "integer", enum: [8, 10, 12], default: 12, description: "bits of a digital number" },
    road: { oneOf: [{ $ref: "#/$defs/Flat" }, { $ref: "#/$defs/Step" }, { $ref: "#/$defs/Own" }], default: { kind: "flat" } },
    detector: { anyOf: [{ oneOf: [{ $ref: "#/$defs/Step" }] }, { type: "null" }], default: null },
    lamps: { type: "array", items: { $ref: "#/$defs/Lamp" }, default: [] },
    functions: { type: "object", patternProperties: { "^[a-z]*$": { $ref: "#/$defs/Gains" } }, default: {} },
  },
};
const schemas = new Schemas(root);
const of = (key: string) => root.properties![key];

test("forms are those of the schema, and variants of one's own code cannot be chosen", () => {
  const road = schemas.field(of("road")).form;
  assert.ok(road.is === "variants" && road.tag === "kind");
  assert.deepEqual([...road.of.keys()], ["flat", "step"]);
  assert.equal(schemas.field(of("bits")).form.is, "choice");
  assert.equal(schemas.field(of("detector")).optional, true);
  assert.equal(schemas.field(of("functions")).form.is, "mapping");
  assert.equal(schemas.field(of("lamps")).form.is, "list");
});

test("what is added has all that has to be given, and can be told from an empty table", () => {
  assert.deepEqual(schemas.fresh(of("road"), "", "step"), { kind: "step" });
  assert.deepEqual(schemas.fresh(of("detector")), { kind: "step" });
  assert.deepEqual(schemas.fresh({ $ref: "#/$defs/Lamp" }), { position_m: [20, 5] });
  assert.deepEqual(schemas.fresh({ $ref: "#/$defs/Gains" }, "mine"), { kp: 0.3 });
  assert.deepEqual(schemas.fresh({ $ref: "#/$defs/Walker" }, "walker_2"), { name: "walker_2", track: [{ position_m: [20, 5] }] });
});

test("overrides are TOML, and null leaves a key out", () => {
  assert.equal(override("a.b", null), "a.b={}");
  assert.equal(override("image", 'a "b"'), 'image="a \\"b\\""');
  assert.equal(toml({ kp: 0.5, none: null, "odd key": [1, true] }), '{kp = 0.5, "odd key" = [1, true]}');
  assert.equal(part(part("objects", 2), "x_m"), "objects[2].x_m");
  assert.equal(valueAt({ objects: [{}, { x_m: 3 }] }, "objects[1].x_m"), 3);
  assert.equal(valueAt({ objects: [] }, "objects[1].x_m"), undefined);
});

test("units come from the ends of names", () => {
  const names = ["x_m", "speed_m_s", "yaw_deg", "rate_deg_s", "ambient_lx", "luminance_cd_m2", "a_m", "kp", "sensitivity_e_per_cd_s_m2"];
  assert.deepEqual(
    names.map((name) => unitOf(name).unit),
    ["m", "m/s", "°", "°/s", "lx", "cd/m²", "", "", ""],
  );
});

test("a slider spans the range, or what is common where that is far wider", () => {
  const range = (least: number, most: number, whole = false) => ({ least, most, open: false, whole });
  assert.deepEqual(span(range(0, 1), "share", 0.4, 0.5), [0, 1]);
  assert.deepEqual(span(range(-1e6, 1e6), "kp", 0.75, 0.5), [0, 5]);
  assert.deepEqual(span(range(-1e6, 1e6), "kp", -0.75, 0.5), [-5, 5]);
  assert.deepEqual(span(range(-10000, 10000), "y_m", 0, 0), [-10, 10]);
  assert.equal(span(range(0, 2 ** 63, true), "seed", 3, 0), null);
  assert.equal(stepOf([0, 5], false), 0.02);
  assert.equal(stepOf([0, 20], true), 1);
  assert.equal(stepFor(500, false), 20);
});

test("the longest beginning of a key says when it acts", () => {
  const acts = { "": "prepared", functions: "step", "camera.bits": "restart" } as const;
  assert.equal(actsOf("functions.a.x_m", acts), "step");
  assert.equal(actsOf("camera.bits", acts), "restart");
  assert.equal(actsOf("camera.z_m", acts), "prepared");
  assert.equal(actsOf("objects[2].x_m", acts), "prepared");
  assert.equal(actsOf("seed", {}), null);
});

test("a search finds the topmost keys by names and descriptions, in variants and in tables by name", () => {
  const model = { bits: 12, road: { kind: "step", x_m: 20 }, detector: null, lamps: [{ position_m: [1, 2] }], functions: { a: { kp: 1 } } };
  const keys = (text: string) => search(schemas, model, text).map(({ key }) => key);
  assert.deepEqual(keys("proportional"), ["functions.a.kp"]);
  assert.deepEqual(keys("functions"), ["functions"]);
  assert.deepEqual(keys("x_m"), ["road.x_m"]);
  assert.deepEqual(keys("position"), ["lamps[0].position_m"]);
  assert.deepEqual(keys("digital bits"), ["bits"]);
  assert.deepEqual(keys("none of this"), []);
});

test("a refusal is cut to what it says of the key or of the table around it", () => {
  const text = "/x/a.toml with a.b.c=3 d=4: a.b: too large; take less";
  assert.equal(told(text, "a.b.c"), "a.b: too large; take less");
  assert.equal(told(text, "d"), null);
});

test("plain data is compared by value", () => {
  assert.ok(same({ a: [1, { b: 2 }], c: null }, { c: null, a: [1, { b: 2 }] }));
  assert.ok(!same({ a: 1 }, { a: 1, b: 2 }) && !same([1], [2]) && !same(null, {}));
});
