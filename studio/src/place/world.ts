// What else has a place: street lamps, spots and shapes of the road, the camera and the car's lamps.

import { Box3, Matrix4, Vector3 } from "three";
import { type Table, valueAt } from "../model/overrides.ts";
import type { Model } from "../protocol.ts";
import { figure, type Keys, keyed, listed } from "./keyed.ts";
import { rounded } from "./poses.ts";
import type { Thing } from "./thing.ts";

const WIDE_M = 8; // outline of what lies across the whole road
const FLAT: Keys = { x: "x_m", y: "y_m", yaw: "yaw_deg", length: "length_m", width: "width_m" };
const CAMERA: Keys = { x: "x_m", y: "y_m", z: "z_m", roll: "roll_deg", pitch: "pitch_deg", yaw: "yaw_deg" };
const SHAPES: Record<string, Keys> = {
  speed_bump: { x: "x_m", length: "length_m" },
  step: { x: "x_m", length: "ramp_m" },
  curb: { y: "y_m" },
  pothole: { x: "x_m", y: "y_m", length: "diameter_m" },
};

export function worldThings(model: Model): Thing[] {
  const lamps = ((model.light as Table).street_lamps as Table[]).map((_, k) => {
    const said = { key: `light.street_lamps[${k}]`, title: `street lamp ${k}`, kind: "street lamp", sort: "light" } as const;
    return keyed(model, { ...said, keys: listed("position_m"), others: ["intensity_cd"] });
  });
  const spots = (model.spots as Table[]).map((spot, k) => {
    const said = { key: `spots[${k}]`, title: `${spot.material ?? "spot"} ${k}`, kind: "spot", sort: "road" } as const;
    return keyed(model, { ...said, keys: FLAT, others: ["albedo_factor"] });
  });
  return [...lamps, ...spots, ...probes(model), ...shapeOfRoad(model), camera(model), carLamps(model)];
}

/** Those on objects are listed, and ride along. */
function probes(model: Model): Thing[] {
  return Object.entries((model.probes ?? {}) as Record<string, Table>).map(([name, { frame }]) => {
    const said = { key: `probes.${name}`, title: name, kind: "probe", sort: frame === "car" ? "car" : "light" } as const;
    return { ...keyed(model, { ...said, keys: listed("position_m") }), placed: frame === "world" || frame === "car" };
  });
}

function shapeOfRoad(model: Model): Thing[] {
  const kind = String((model.road as Table).kind);
  const keys = SHAPES[kind];
  if (!keys) return [];
  const size = (name: string | undefined, other: number) => (name ? Number(valueAt(model, `road.${name}`)) : other);
  const half = kind === "curb" ? new Vector3(40, 0.1, 0) : new Vector3(size(keys.length, 1) / 2, WIDE_M / 2, 0);
  if (kind === "pothole") half.y = half.x;
  const bounds = new Box3(half.clone().negate(), half);
  const others = kind === "pothole" ? ["depth_m", "edge_m"] : ["height_m"];
  return [keyed(model, { key: "road", title: kind.replace("_", " "), kind, sort: "road", keys, bounds, others })];
}

function camera(model: Model): Thing {
  return keyed(model, { key: "camera", title: "camera", kind: "camera", sort: "car", keys: CAMERA, others: ["hfov_deg"] });
}

/** Both lamps at once, by the place of the left one. */
function carLamps(model: Model): Thing {
  const { height_m, distance_m } = model.headlight as { height_m: number; distance_m: number };
  return {
    key: "headlight",
    title: "lamps",
    kind: "lamps",
    sort: "car",
    placed: true,
    partOf: null,
    T: new Matrix4().setPosition(0, distance_m / 2, height_m),
    bounds: new Box3(),
    way: [],
    axes: { move: "YZ", turn: "", scale: "" },
    changes: (T) => {
      const { y, z } = new Vector3().setFromMatrixPosition(T);
      const [distance, height] = [rounded("x", 2 * y), rounded("x", z)];
      return [
        ...(distance === distance_m ? [] : [["headlight.distance_m", distance] as const]),
        ...(height === height_m ? [] : [["headlight.height_m", height] as const]),
      ];
    },
    figures: ["distance_m", "height_m", "level_deg", "swivel_deg"].map((name) => figure("headlight", name)),
  };
}
