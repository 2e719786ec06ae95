// Which columns are drawn, and in which chart.

import type { Column } from "../protocol.ts";
import type { Rows } from "../rows.ts";

/** A curve: a column, or the sum of several. */
export interface Curve {
  label: string;
  title: string;
  columns: string[];
}

export interface Group {
  title: string;
  unit: string;
  /** Of the vertical axis, where it is known. */
  range: [number, number] | null;
  curves: Curve[];
}

interface Kind {
  title: string;
  unit: string;
  range: [number, number] | null;
  matches: RegExp;
}

const TIME = "processing_ms";
const KINDS: Kind[] = [
  { title: "Overlap with target (IoU)", unit: "1", range: [0, 1], matches: /^functions\..+\.iou$/ },
  { title: "Luminous flux", unit: "lm", range: null, matches: /(^|\.)flux_lm$/ },
  { title: "Illuminance on objects", unit: "lx", range: null, matches: /^objects\..+\.lx_max$/ },
  { title: "Illuminance on probes", unit: "lx", range: null, matches: /^probes\..+\.lx$/ },
  { title: "Detection confidence", unit: "1", range: [0, 1], matches: /^objects\..+\.confidence$/ },
  { title: "Time of a step", unit: "ms", range: null, matches: /^processing_ms$/ },
];
const MOST = 8; // curves of a chart at first; more cannot be told apart

/** Names of the columns that are drawn unless others are chosen. */
export function defaults(columns: readonly Column[]): Set<string> {
  return new Set(KINDS.flatMap(({ matches }) => columns.filter(({ name }) => matches.test(name)).slice(0, MOST)).map(({ name }) => name));
}

/** Charts of chosen columns: the usual ones, then one for each unit of all others. */
export function groups(columns: readonly Column[], chosen: ReadonlySet<string>): Group[] {
  const rest = columns.filter(({ name }) => chosen.has(name) && !KINDS.some(({ matches }) => matches.test(name)));
  const usual = KINDS.map(({ matches, ...kind }): Group => {
    const curves = columns
      .filter(({ name }) => chosen.has(name) && matches.test(name))
      .map(curve)
      .map(shortened);
    return { ...kind, curves: kind.unit === "ms" && curves.length ? [...curves, sum(columns)] : curves };
  });
  const others = [...new Set(rest.map(({ unit }) => unit))].map((unit): Group => {
    const curves = rest.filter((each) => each.unit === unit).map(curve);
    return { title: curves.length === 1 ? curves[0].label : unit ? `Chosen, in ${unit}` : "Chosen", unit, range: null, curves };
  });
  return [...usual, ...others].filter(({ curves }) => curves.length > 0);
}

function curve({ name, unit, description }: Column): Curve {
  const label = name.replace(/^(functions|objects|probes|lamp)\./, "");
  return { label, title: `${name}${unit ? ` in ${unit}` : ""}: ${description}`, columns: [name] };
}

/** In a chart whose title says what all of its curves are, a name says of what. */
function shortened(each: Curve): Curve {
  return { ...each, label: each.label.replace(/\.(iou|flux_lm|lx_max|lx|confidence)$/, "") };
}

function sum(columns: readonly Column[]): Curve {
  const parts = columns.map(({ name }) => name).filter((name) => name.endsWith("_ms") && name !== TIME);
  return { label: "sum of *_ms", title: `Sum of ${parts.join(", ")}, in ms`, columns: parts };
}

/** Values of a curve by step: the sum of the columns that have one, NaN without any. */
export function valuesOf(curve: Curve, rows: Rows): (step: number) => number {
  const columns = curve.columns.map((name) => rows.column(name)).filter((column) => column !== null);
  return (step) => {
    let total = Number.NaN;
    for (const column of columns) {
      const value = column[step];
      if (!Number.isNaN(value)) total = Number.isNaN(total) ? value : total + value;
    }
    return total;
  };
}
