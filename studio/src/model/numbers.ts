// How a number is shown and moved: its unit, the span of its slider, and its steps.

import { type Range, within } from "./schema.ts";

const UNITS: [string, string][] = [
  ["_m_s2", "m/s²"],
  ["_m_s", "m/s"],
  ["_deg_s", "°/s"],
  ["_cd_m2", "cd/m²"],
  ["_lm_w", "lm/W"],
  ["_deg", "°"],
  ["_rad", "rad"],
  ["_cd", "cd"],
  ["_lx", "lx"],
  ["_lm", "lm"],
  ["_hz", "Hz"],
  ["_px", "px"],
  ["_percent", "%"],
  ["_steps", "steps"],
  ["_frames", "frames"],
  ["_sigma", "σ"],
  ["_e", "e⁻"],
  ["_w", "W"],
  ["_s", "s"],
  ["_m", "m"],
];
const WEIGHTS = /(^|\.)a_[^.]*$|_per_[^.]*$/; // names whose end is no unit
const WIDEST = 400; // a span that a slider resolves

/** Unit of a key by the end of its name, and that end, both empty without one. */
export function unitOf(key: string): { unit: string; end: string } {
  const [end, unit] = (!WEIGHTS.test(key) && UNITS.find(([each]) => key.endsWith(each))) || ["", ""];
  return { unit, end };
}

/** Ends of a slider; null where none is of use. Where the range is far wider than what is common, they lie around value and default. */
export function span(range: Range, key: string, value: number, usual: unknown): [number, number] | null {
  const { least, most, whole } = range;
  if (most - least <= WIDEST) return [least, most];
  if (whole) return null;
  const size = Math.max(Math.abs(value), typeof usual === "number" ? Math.abs(usual) : 0);
  const end = size > 0 ? round(4 * size, Math.ceil) : 10;
  const bothWays = value < 0 || (typeof usual === "number" && usual < 0) || ["m", "°"].includes(unitOf(key).unit);
  return [within(bothWays ? -end : 0, range), Math.min(most, end)];
}

/** A step of a span: 1, 2 or 5 times a power of ten, a whole number of whole ones. */
export function stepOf([low, high]: [number, number], whole: boolean): number {
  const step = round((high - low) / 200, Math.floor);
  return whole ? Math.max(1, Math.round(step)) : step;
}

/** Step of a number without a slider. */
export function stepFor(value: number, whole: boolean): number {
  return whole ? 1 : value === 0 ? 0.1 : round(Math.abs(value) / 20, Math.floor);
}

/** 1, 2 or 5 times a power of ten. */
function round(size: number, way: (value: number) => number): number {
  const power = 10 ** Math.floor(Math.log10(size));
  const mantissas = way === Math.ceil ? [1, 2, 5, 10] : [10, 5, 2, 1];
  const found = mantissas.find((each) => (way === Math.ceil ? each >= size / power - 1e-9 : each <= size / power + 1e-9));
  return +((found ?? 1) * power).toPrecision(12);
}
