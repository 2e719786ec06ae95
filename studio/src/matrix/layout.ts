// Where modules lie beside each other: the left lamp's on the left, one below the other, as wide as their fields compare.

import type { Module } from "../protocol.ts";

export interface Tile {
  module: number;
  x: number;
  y: number;
  width: number;
  height: number;
}

export interface Layout {
  width: number;
  height: number;
  tiles: Tile[];
}

const LAMP = 1000; // units that a lamp is wide
const GAP = 50;
const LABEL = 90; // height above a module for its name
const NARROWEST = 0.25; // of the widest, so that it can be seen

export function layout(modules: readonly Module[]): Layout {
  const field = ({ left, right }: Module) => Math.abs(left - right);
  const widest = Math.max(...modules.map(field), 1e-9);
  const sides = (["left", "right"] as const).filter((side) => modules.some((each) => each.side === side));
  const tiles: Tile[] = [];
  let tallest = 0;
  sides.forEach((side, place) => {
    let y = 0;
    modules.forEach((each, module) => {
      if (each.side !== side) return;
      const width = LAMP * Math.max(NARROWEST, field(each) / widest);
      const height = (width * Math.abs(each.top - each.bottom)) / Math.max(field(each), 1e-9);
      tiles.push({ module, x: place * (LAMP + GAP) + (LAMP - width) / 2, y: y + LABEL, width, height });
      y += LABEL + height;
    });
    tallest = Math.max(tallest, y);
  });
  return { width: Math.max(1, sides.length * (LAMP + GAP) - GAP), height: Math.max(1, tallest), tiles };
}
