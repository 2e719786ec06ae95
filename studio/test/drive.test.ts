import assert from "node:assert/strict";
import { test } from "node:test";
import { isControl, ofKeys, ofPads, type Pad, shoulders, turned } from "../src/drive/controls.ts";
import { blinks, pressed } from "../src/drive/indicator.ts";
import { commanding, nameOf, REST } from "../src/drive/modules.ts";

function pad(stick: number, brake: number, accelerate: number, mapping = "standard"): Pad {
  const buttons = Array.from({ length: 17 }, (_, k) => ({ value: k === 6 ? brake : k === 7 ? accelerate : 0 }));
  return { mapping, connected: true, axes: [stick, 0, 0, 0], buttons };
}

test("keys accelerate, brake and steer; opposite ones cancel each other, and the brake wins", () => {
  assert.deepEqual(ofKeys(new Set(["ArrowUp", "KeyA"])), { throttle: 1, steering: 1 });
  assert.deepEqual(ofKeys(new Set(["KeyW", "ArrowDown", "ArrowLeft", "KeyD"])), { throttle: -1, steering: 0 });
  assert.deepEqual(ofKeys(new Set(["KeyQ"])), { throttle: 0, steering: 0 });
  assert.ok(isControl("KeyS") && !isControl("Space"));
});

test("of a gamepad the triggers and the left stick count, beyond its dead part", () => {
  assert.deepEqual(ofPads([null, pad(-1, 0, 0.5)]), { throttle: 0.5, steering: 1 });
  assert.deepEqual(ofPads([pad(1, 0.75, 0.25)]), { throttle: -0.5, steering: -1 });
  assert.equal(ofPads([pad(0.05, 0, 0)]), null);
  assert.equal(ofPads([pad(1, 0, 1, "")]), null);
  const half = ofPads([pad(-0.54, 0, 0)]);
  assert.ok(half && Math.abs(half.steering - 0.5) < 1e-12);
  assert.deepEqual(ofPads([pad(0, 0, 0), pad(0, 0, 1)]), { throttle: 1, steering: 0 });
});

test("a key turns the wheel within half a second, and back", () => {
  let steering = 0;
  for (let k = 0; k < 5; k++) steering = turned(steering, 1, 0.05);
  assert.ok(Math.abs(steering - 0.5) < 1e-9);
  assert.equal(turned(0.9, 1, 1), 1);
  assert.ok(Math.abs(turned(0.5, 0, 0.1) - 0.3) < 1e-9);
});

test("the same switch again ends an indication, another one replaces it; hazard lights blink on both sides", () => {
  assert.deepEqual(
    [pressed("off", "left"), pressed("left", "left"), pressed("left", "right"), pressed("hazard", "hazard")],
    ["left", "off", "right", "off"],
  );
  assert.ok(blinks("left", "left") && !blinks("left", "right") && blinks("hazard", "left") && blinks("hazard", "right"));
  assert.ok(blinks("hazard", "hazard") && !blinks("off", "left"));
});

test("shoulder buttons of a standard gamepad indicate", () => {
  const held = { mapping: "standard", connected: true, axes: [0, 0], buttons: [0, 0, 0, 0, 1, 0].map((value) => ({ value })) };
  assert.deepEqual(shoulders([null, held]), { left: true, right: false });
  assert.deepEqual(shoulders([{ ...held, mapping: "" }]), { left: false, right: false });
});

test("a module is commanded by a function of its own, which goes when it rests", () => {
  const command = { swivel_deg: 5, level_deg: 0, intensity: 0.5 };
  assert.equal(
    commanding("left hires", command, false),
    'functions.commanded_left_hires={kind = "command", modules = ["left hires"], swivel_deg = 5, intensity = 0.5}',
  );
  assert.equal(commanding("left hires", REST, true), "functions.commanded_left_hires={}");
  assert.equal(commanding("left hires", REST, false), null);
  assert.equal(nameOf('left Fine-2 "a.b"'), "commanded_left_fine_2_a_b_");
});
