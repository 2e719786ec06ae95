import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";
import { decode, encode } from "../src/framing.ts";

function frame(head: object, ...bodies: Uint8Array[]): ArrayBuffer {
  const text = new TextEncoder().encode(JSON.stringify(head));
  const all = Buffer.concat([new Uint8Array(new Uint32Array([text.length]).buffer), text, ...bodies]);
  return all.buffer.slice(all.byteOffset, all.byteOffset + all.length) as ArrayBuffer;
}

test("a client's message is its head alone, with its length before it", () => {
  const bytes = new Uint8Array(encode({ type: "speed", factor: 0.25 }));
  assert.equal(new DataView(bytes.buffer).getUint32(0, true), bytes.length - 4);
  assert.deepEqual(JSON.parse(new TextDecoder().decode(bytes.subarray(4))), { type: "speed", factor: 0.25 });
});

test("arrays come out as they went in, raw or compressed, wherever they start", async () => {
  const rows = new Float32Array([0.5, Number.NaN, -3]);
  const half = new Uint16Array([0x3c00, 0x4000]); // 1 and 2
  const packed = deflateSync(new Uint8Array(half.buffer));
  const arrays = {
    odd: { dtype: "u1", shape: [1], start: 0, bytes: 1, coding: "raw" },
    rows: { dtype: "f4", shape: [1, 3], start: 1, bytes: 12, coding: "raw" },
    "light.0": { dtype: "f2", shape: [1, 2], start: 13, bytes: packed.length, coding: "deflate" },
  };
  const [message, found] = await decode(
    frame({ type: "rows", run: 0, first: 7, arrays }, new Uint8Array([9]), new Uint8Array(rows.buffer), packed),
  );
  assert.deepEqual(message, { type: "rows", run: 0, first: 7 });
  assert.deepEqual(found.get("rows"), { shape: [1, 3], values: rows });
  assert.deepEqual(found.get("light.0")?.values, half);
});

test("a frame that ends too early is an error that says so", async () => {
  await assert.rejects(decode(new Uint32Array([50]).buffer), /a head of 50 bytes in a frame of 4/);
  const arrays = { rows: { dtype: "f4", shape: [1, 1], start: 0, bytes: 4, coding: "raw" } };
  await assert.rejects(decode(frame({ type: "rows", arrays })), /array rows ends after its frame/);
});
