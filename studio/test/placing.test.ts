import assert from "node:assert/strict";
import { test } from "node:test";
import { Matrix4, Vector3 } from "three";
import { patched, unused } from "../src/model/overrides.ts";
import { matrixOf, poseOf } from "../src/place/poses.ts";
import { lying } from "../src/place/spot.ts";
import type { Thing } from "../src/place/thing.ts";
import { thingsOf } from "../src/place/things.ts";
import type { Model } from "../src/protocol.ts";

const MODEL = {
  functions: {
    gate: { kind: "primitive", x_m: 25, y_m: 1, z_m: 1.5, roll_deg: 0, pitch_deg: -90, yaw_deg: 10, width_m: 2, length_m: 3 },
    held: { kind: "symbol", controller: { name: "open" }, observer: null, x_m: 17, y_m: 0, yaw_deg: 0, width_m: 2, length_m: 4 },
    lane: { kind: "lane" },
  },
  objects: [
    {
      name: "walker",
      kind: "pedestrian",
      on_road: true,
      path: null,
      track: [{ position_m: [20, 2, 0], roll_deg: 0, pitch_deg: 0, yaw_deg: 90 }],
    },
    {
      name: "car",
      kind: "car",
      on_road: false,
      track: [],
      path: {
        points_m: [
          [60, 3, 0],
          [5, 3, 0],
        ],
        speed_m_s: 14,
        start_s: 0,
      },
    },
  ],
  light: { street_lamps: [] },
  spots: [],
  road: { kind: "speed_bump", x_m: 17, height_m: 0.08, length_m: 1 },
  headlight: { height_m: 0.75, distance_m: 1.2 },
  camera: { x_m: -1.6, y_m: 0, z_m: 1.35, roll_deg: 0, pitch_deg: 3, yaw_deg: 0 },
} as unknown as Model;
const NOBODY = { body: () => null };
const ONE = new Vector3(1, 1, 1);

function thing(key: string, model = MODEL): Thing {
  return thingsOf(model, model, NOBODY).find((each) => each.key === key)!;
}

function moved({ T, changes }: Thing, by: [number, number, number], scale = ONE, steps = false): Record<string, number> {
  return Object.fromEntries(changes(new Matrix4().makeTranslation(...by).multiply(T), scale, steps));
}

test("a pose is what its matrix is made of, and upright it has no roll", () => {
  const pose = { x: 1, y: -2, z: 3, roll: 20, pitch: -50, yaw: 110 };
  for (const [name, value] of Object.entries(poseOf(matrixOf(pose)))) assert.ok(Math.abs(value - pose[name as keyof typeof pose]) < 1e-9);
  const upright = poseOf(matrixOf({ pitch: -90, yaw: 30 }));
  assert.ok(Math.abs(upright.roll) < 1e-6 && Math.abs(upright.yaw - 30) < 1e-6);
});

test("of a primitive that is moved or scaled the keys are told that change", () => {
  const gate = thing("functions.gate");
  assert.deepEqual(gate.axes, { move: "XYZ", turn: "XYZ", scale: "XY" });
  assert.deepEqual(moved(gate, [0, 2, 0.5]), { "functions.gate.y_m": 3, "functions.gate.z_m": 2 });
  assert.deepEqual(moved(gate, [0, 0, 0], new Vector3(2, 1, 1)), { "functions.gate.length_m": 6 });
  const turned = gate.changes(matrixOf({ x: 25, y: 1, z: 1.5, pitch: -90, yaw: 40 }), ONE);
  assert.deepEqual(turned, [["functions.gate.yaw_deg", 40]]);
});

test("what has no key cannot be changed", () => {
  const held = thing("functions.held");
  assert.deepEqual(held.axes, { move: "XY", turn: "", scale: "XY" });
  assert.deepEqual(moved(held, [1, 0, 5]), { "functions.held.x_m": 18 });
  assert.equal(thing("functions.lane").placed, false);
  assert.deepEqual(moved(thing("road"), [2, 2, 0]), { "road.x_m": 19 });
  assert.deepEqual(moved(thing("headlight"), [0, 0.1, 0]), { "headlight.distance_m": 1.4 });
});

test("the whole course of an object is moved, or one of its points", () => {
  assert.deepEqual(moved(thing("objects[1]"), [1, 0, 0]), {
    "objects[1].path.points_m[0][0]": 61,
    "objects[1].path.points_m[1][0]": 6,
  });
  assert.deepEqual(moved(thing("objects[1].path.points_m[1]"), [1, 0, 0]), { "objects[1].path.points_m[1][0]": 6 });
});

test("a model with other values shares what has not changed", () => {
  const other = patched(MODEL, [["objects[0].track[0].position_m[1]", 4]]);
  assert.deepEqual(moved(thing("objects[0]", other), [0, 1, 0]), { "objects[0].track[0].position_m[1]": 5 });
  assert.equal((MODEL.objects as { track: { position_m: number[] }[] }[])[0]!.track[0]!.position_m[1], 2);
  assert.equal(other.functions, MODEL.functions);
});

test("a rectangle lies on what was clicked with its first row on top", () => {
  assert.deepEqual(lying(new Vector3(0, 0, 1)), { pitch_deg: 0, yaw_deg: 0 });
  assert.deepEqual(lying(new Vector3(-1, 0, 0)), { pitch_deg: -90, yaw_deg: 0 });
  const normal = new Vector3(-1, 2, 1).normalize();
  const { pitch_deg, yaw_deg } = lying(normal);
  const made = new Vector3().setFromMatrixColumn(matrixOf({ pitch: pitch_deg, yaw: yaw_deg }), 2);
  assert.ok(made.distanceTo(normal) < 1e-3);
});

test("names that are known get a number", () => {
  assert.equal(unused("car", ["box"]), "car");
  assert.equal(unused("car", ["car"]), "car_2");
  assert.equal(unused("car_2", ["car", "car_2"]), "car_3");
});

test("what is dragged keeps to steps of 0.1 m and 5 degrees, and what is not dragged stays", () => {
  const gate = thing("functions.gate");
  assert.deepEqual(moved(gate, [0.234, 0, 0], ONE, true), { "functions.gate.x_m": 25.2 });
  assert.deepEqual(moved(gate, [0.234, 0, 0]), { "functions.gate.x_m": 25.234 });
  const turned = gate.changes(matrixOf({ x: 25, y: 1, z: 1.5, pitch: -90, yaw: 43 }), ONE, true);
  assert.deepEqual(Object.fromEntries(turned), { "functions.gate.yaw_deg": 45 });
  const tiny = gate.changes(gate.T, new Vector3(0.01, 1, 1), true);
  assert.ok(tiny.every(([, value]) => value > 0));
});
