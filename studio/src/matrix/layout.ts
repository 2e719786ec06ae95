// Where modules lie beside each other: the left lamp's on the left, one below the other or in columns, as wide as their fields compare.

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

const WIDEST = 1000; // units that the module with the widest field is wide
const GAP = 50;
const LABEL = 90; // height above a module for its name
const NARROWEST = 0.25; // of the widest, so that it can be seen
const ASPECT = 2.4; // width of the panel by its height

/** The layout in which modules are largest. */
export function layout(modules: readonly Module[]): Layout {
  const most = Math.max(1, ...SIDES.map((side) => modules.filter((each) => each.side === side).length));
  const all = Array.from({ length: most }, (_, k) => inColumns(modules, k + 1));
  const size = ({ width, height }: Layout) => Math.max(width, ASPECT * height);
  return all.reduce((best, each) => (size(each) < size(best) ? each : best));
}

const SIDES = ["left", "right"] as const;

function inColumns(modules: readonly Module[], columns: number): Layout {
  const field = ({ left, right }: Module) => Math.abs(left - right);
  const widest = Math.max(...modules.map(field), 1e-9);
  const sides = SIDES.filter((side) => modules.some((each) => each.side === side));
  const lamp = columns * (WIDEST + GAP) - GAP;
  const tiles: Tile[] = [];
  let tallest = 0;
  sides.forEach((side, place) => {
    const own = [...modules.keys()].filter((module) => modules[module].side === side);
    let y = 0;
    for (let first = 0; first < own.length; first += columns) {
      const row = own.slice(first, first + columns).map((module, column): Tile => {
        const { bottom, top } = modules[module];
        const width = WIDEST * Math.max(NARROWEST, field(modules[module]) / widest);
        const height = (width * Math.abs(top - bottom)) / Math.max(field(modules[module]), 1e-9);
        const x = GAP / 2 + place * (lamp + 2 * GAP) + column * (WIDEST + GAP) + (WIDEST - width) / 2;
        return { module, x, y: y + LABEL, width, height };
      });
      tiles.push(...row);
      y += LABEL + Math.max(...row.map(({ height }) => height));
    }
    tallest = Math.max(tallest, y);
  });
  return { width: Math.max(1, sides.length * (lamp + 2 * GAP) - GAP), height: tallest + GAP / 2, tiles };
}
