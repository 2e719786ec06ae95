// Arrays of a message's body.

export type Values = Uint8Array | Uint16Array | Uint32Array | Float32Array;

/** An array; rows x columns and so on are in `shape`. */
export interface Picture {
  readonly shape: number[];
  /** Half floats (`f2`) come as their 16 bits, in a Uint16Array. */
  readonly values: Values;
}
export type Arrays = ReadonlyMap<string, Picture>;

/** 16 numbers of a 4 x 4 matrix, row by row; `T_a_b` takes points of frame b to frame a. Frames are x forward, y left, z up. */
export type Matrix4x4 = number[];
export type Vector = [number, number, number];
