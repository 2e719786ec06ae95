// What can be added, and the tables that it begins with.

import type { List, Table } from "../model/overrides.ts";
import type { Spot } from "./spot.ts";

export interface Addable {
  name: string;
  /** What to do, for the user. */
  say: string;
  /** List or table that gets it. */
  into: List;
  /** Null where it cannot be there. */
  make(spot: Spot): Table | null;
  /** Of what is placed by several clicks, in place of `make`. */
  way?(spots: readonly Spot[]): Table;
}

const ROAD = "Click on the road to place it.";
const OBJECT = "Click on the object that is meant.";

export function addables(symbols: readonly string[]): readonly (readonly [string, readonly Addable[]])[] {
  return [
    ["Light", [...PRIMITIVES, ...symbols.map(symbol), PATH, ...OF_OBJECTS]],
    ["Objects", OBJECTS],
    ["Surroundings", SURROUNDINGS],
  ];
}

const PRIMITIVES: readonly Addable[] = [
  { name: "primitive on the road", say: ROAD, into: "functions", make: ({ ground: [x, y] }) => ({ kind: "primitive", x_m: x, y_m: y }) },
  {
    name: "primitive, upright",
    say: "Click on the road where it stands.",
    into: "functions",
    make: ({ ground: [x, y, z] }) => ({ kind: "primitive", x_m: x, y_m: y, z_m: millimetres(z + 1), pitch_deg: -90, length_m: 2 }),
  },
  {
    name: "primitive on a surface",
    say: "Click on the surface that it lies on.",
    into: "functions",
    make: ({ ground: [x, y, z], lies }) => ({ kind: "primitive", x_m: x, y_m: y, z_m: z, ...lies, width_m: 1, length_m: 1 }),
  },
];

function symbol(image: string): Addable {
  return {
    name: `symbol: ${image.replaceAll("_", " ")}`,
    say: ROAD,
    into: "functions",
    make: ({ ground: [x, y] }) => ({ kind: "symbol", image, x_m: x, y_m: y }),
  };
}

const PATH: Addable = {
  name: "path of light",
  say: "",
  into: "functions",
  make: () => null,
  way: (spots) => ({ kind: "path", control_m: spots.map(({ ground: [x, y] }) => [x, y]) }),
};

const OF_OBJECTS: readonly Addable[] = [
  {
    name: "marker: line to an object",
    say: OBJECT,
    into: "functions",
    make: ({ object }) => meant(object) && { kind: "marker", ...meant(object) },
  },
  {
    name: "marker: light on an object",
    say: OBJECT,
    into: "functions",
    make: ({ object }) => meant(object) && { kind: "marker", target: "body", ...meant(object) },
  },
  {
    name: "mask of an object",
    say: OBJECT,
    into: "functions",
    make: ({ object }) => meant(object) && { kind: "glare_free", ...meant(object) },
  },
];

/** Selection of one object; trackers report only those that have a category. */
function meant(object: Table | null): Table | null {
  return object?.category ? { categories: [object.category], names: [object.name] } : null;
}

const OBJECTS: readonly Addable[] = [
  object("car, oncoming", { kind: "car" }, 180),
  object("car, ahead", { kind: "car" }, 0),
  object("car, parked", { kind: "car", lit: false }, 0),
  object("pedestrian", { kind: "pedestrian" }, 90),
  object("cyclist", { kind: "cyclist" }, 0),
  object("motorcycle, oncoming", { kind: "motorcycle" }, 180),
  object("motorcycle, ahead", { kind: "motorcycle" }, 0),
  object("deer", { kind: "animal" }, 90),
  object("traffic sign", { kind: "traffic_sign" }, 180),
  object("box", { kind: "box", size_m: [0.6, 0.6, 0.6], category: "other" }, 0),
  ...["tree", "bush", "post", "bin", "delineator"].map((shape) => object(shape, { kind: "clutter", shape }, 0)),
  ...["lorry", "bus", "tractor", "motor_scooter", "wheelchair", "pram", "child", "boar", "dog", "poster"].map((model) =>
    object(model.replace("_", " "), { kind: "model", model }, 180),
  ),
];

function object(name: string, table: Table, yaw_deg: number): Addable {
  return {
    name,
    say: ROAD,
    into: "objects",
    make: ({ world: [x, y], heading_deg }) => ({
      ...table,
      track: [{ position_m: [x, y, 0], yaw_deg: turn(heading_deg + yaw_deg) }],
      on_road: true,
    }),
  };
}

const SURROUNDINGS: readonly Addable[] = [
  {
    name: "street lamp",
    say: "Click on the ground below it.",
    into: "light.street_lamps",
    make: ({ world: [x, y, z] }) => ({ position_m: [x, y, millimetres(z + 6)], intensity_cd: 2000 }),
  },
  spot("puddle", { material: "wet_asphalt", length_m: 2, width_m: 1.5 }),
  spot("patch of asphalt", { shape: "rectangle", albedo_factor: 0.5, length_m: 3, width_m: 2 }),
  spot("paint", { shape: "rectangle", material: "lane_paint", length_m: 3, width_m: 0.3 }),
];

function spot(name: string, table: Table): Addable {
  return {
    name,
    say: ROAD,
    into: "spots",
    make: ({ world: [x, y], heading_deg }) => ({ x_m: x, y_m: y, yaw_deg: turn(heading_deg), ...table }),
  };
}

function millimetres(value: number): number {
  return Number(value.toFixed(3));
}

/** An angle in -180..180 degrees. */
function turn(angle_deg: number): number {
  return Number((angle_deg - 360 * Math.round(angle_deg / 360)).toFixed(2));
}
