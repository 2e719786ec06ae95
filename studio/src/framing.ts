// Frames of the socket: four bytes with the length of a JSON head, the head, and arrays (docs/programs.md).

import type { Arrays, Picture, Values } from "./arrays.ts";
import type { ClientMessage, ServerMessage } from "./protocol.ts";

interface ArrayHead {
  dtype: "u1" | "u2" | "u4" | "f2" | "f4";
  shape: number[];
  start: number;
  bytes: number;
  coding: "raw" | "deflate";
}

const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f2: Uint16Array, f4: Float32Array } as const;

/** A client's message; its arrays go as they are. */
export function encode(message: ClientMessage, arrays: Arrays = new Map()): ArrayBuffer {
  const heads: Record<string, ArrayHead> = {};
  const bodies: Uint8Array[] = [];
  let start = 0;
  for (const [name, { shape, values }] of arrays) {
    const body = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
    heads[name] = { dtype: dtype(values), shape, start, bytes: body.length, coding: "raw" };
    bodies.push(body);
    start += body.length;
  }
  const head = new TextEncoder().encode(JSON.stringify(start > 0 ? { ...message, arrays: heads } : message));
  const frame = new Uint8Array(4 + head.length + start);
  new DataView(frame.buffer).setUint32(0, head.length, true);
  frame.set(head, 4);
  let at = 4 + head.length;
  for (const body of bodies) {
    frame.set(body, at);
    at += body.length;
  }
  return frame.buffer;
}

function dtype(values: Values): ArrayHead["dtype"] {
  if (values instanceof Float32Array) return "f4";
  return values instanceof Uint8Array ? "u1" : values instanceof Uint16Array ? "u2" : "u4";
}

/** A message and its arrays. Rejects with an Error that says what is wrong with the frame. */
export async function decode(frame: ArrayBuffer): Promise<[ServerMessage, Arrays]> {
  const length = new DataView(frame).getUint32(0, true);
  if (4 + length > frame.byteLength) throw new Error(`a head of ${length} bytes in a frame of ${frame.byteLength}`);
  const { arrays = {}, ...message } = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length)));
  const heads = Object.entries(arrays as Record<string, ArrayHead>);
  const decoded = heads.map(async ([name, head]): Promise<[string, Picture]> => {
    const start = 4 + length + head.start;
    if (start + head.bytes > frame.byteLength) throw new Error(`array ${name} ends after its frame`);
    return [name, await array(head, frame.slice(start, start + head.bytes))];
  });
  return [message as ServerMessage, new Map(await Promise.all(decoded))];
}

async function array(head: ArrayHead, data: ArrayBuffer): Promise<Picture> {
  const plain = head.coding === "deflate" ? await inflated(data) : data;
  return { shape: head.shape, values: new TYPES[head.dtype](plain) as Values };
}

function inflated(data: ArrayBuffer): Promise<ArrayBuffer> {
  return new Response(new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}
