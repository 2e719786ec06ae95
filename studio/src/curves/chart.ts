// One chart: uPlot, and beside it the names of the curves with their numbers.

import uPlot from "uplot";
import { brief } from "../brief.ts";
import { h } from "../dom.ts";
import type { Rows } from "../rows.ts";
import type { RunData } from "../state.ts";
import { type Curve, type Group, valuesOf } from "./groups.ts";
import { places, stretch, thinned } from "./thinned.ts";

/** Told apart without red and green (after Okabe and Ito), light enough for the dark ground. */
const COLOURS = ["#56b4e9", "#e69f00", "#2fc79a", "#f0e442", "#e08fbf", "#ff8a4c", "#8fa8ff", "#c8ccd2"];
const DASH = [5, 4];
const MOST_POINTS = 1200;
const LATELY = 10; // steps in which a number counts as the current one
const MANY = 4; // names that do not fit, so that their list is scrolled
const LEAST_S = 1; // that the horizontal axis spans
const INK = "#b4bcc8";
const GRID = "#2c323b";
const FONT = "11px system-ui, sans-serif";

export interface Shown {
  runs: readonly RunData[];
  rate_hz: number;
  /** Steps to draw. */
  first: number;
  end: number;
  /** Step whose numbers are shown, where the cursor is nowhere. */
  step: number;
  /** Whether that step is an old one that is looked at again. */
  marked: boolean;
}

export class Chart {
  readonly element: HTMLElement;
  readonly #plot: uPlot;
  readonly #room = h("div", { class: "plot", "aria-hidden": "true" }); // the names beside it have its numbers
  readonly #numbers: HTMLElement[][];
  readonly #resize: ResizeObserver;
  #shown: Shown = { runs: [], rate_hz: 1, first: 0, end: 0, step: -1, marked: false };

  /** onpick: a step was clicked. */
  constructor(
    readonly group: Group,
    private readonly runCount: number,
    onpick: (step: number) => void,
  ) {
    this.#numbers = group.curves.map(() => Array.from({ length: runCount }, () => h("output", {})));
    this.element = h("figure", { class: "chart" }, this.#caption(), this.#room);
    this.#plot = new uPlot(this.#options(), [[], ...group.curves.flatMap(() => Array.from({ length: runCount }, () => []))], this.#room);
    this.#plot.over.addEventListener("click", () => {
      const { left = -1 } = this.#plot.cursor;
      if (left >= 0) onpick(Math.round(this.#plot.posToVal(left, "x") * this.#shown.rate_hz));
    });
    this.#resize = new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = this.#room;
      if (width > 0 && height > 0) this.#plot.setSize({ width, height });
    });
    this.#resize.observe(this.#room);
  }

  draw(shown: Shown): void {
    this.#shown = shown;
    const { runs, rate_hz, first, end } = shown;
    const part = stretch(first, end, MOST_POINTS);
    const data: (number | null)[][] = [places(part).map((step) => step / rate_hz)];
    for (const curve of this.group.curves) {
      for (const run of Array(this.runCount).keys()) {
        const rows = runs[run]?.rows;
        data.push(rows ? thinned(valuesOf(curve, rows), part) : data[0].map(() => null));
      }
    }
    this.#plot.setData(data as uPlot.AlignedData);
    this.#write();
  }

  dispose(): void {
    this.#resize.disconnect();
    this.#plot.destroy();
    this.element.remove();
  }

  #caption(): HTMLElement {
    const names = this.group.curves.map(({ label, title }, k) => {
      const key = h("span", { class: "key" });
      key.style.background = COLOURS[k % COLOURS.length];
      return h("li", { title }, key, h("span", { class: "name" }, label), ...this.#numbers[k]);
    });
    return h("figcaption", {}, h("h3", {}, this.group.title), h("ul", names.length > MANY ? { tabindex: 0 } : {}, ...names));
  }

  #write(): void {
    const { runs, rate_hz, step } = this.#shown;
    const { left = -1 } = this.#plot.cursor;
    const at = left >= 0 ? Math.round(this.#plot.posToVal(left, "x") * rate_hz) : step;
    this.group.curves.forEach((curve, k) => {
      this.#numbers[k].forEach((output, run) => {
        const rows = runs[run]?.rows;
        output.textContent = rows ? brief(lately(curve, rows, Math.min(at, rows.count - 1))) : "-";
      });
    });
  }

  #options(): uPlot.Options {
    const axis: uPlot.Axis = { stroke: INK, font: FONT, grid: { stroke: GRID, width: 1 }, ticks: { show: false }, gap: 3 };
    const { unit } = this.group; // the quantity is the title
    const series = this.group.curves.flatMap(({ label }, k) =>
      Array.from({ length: this.runCount }, (_, run): uPlot.Series => {
        return {
          label,
          stroke: COLOURS[k % COLOURS.length],
          width: 1.5,
          points: { show: true, size: 4, filter: alone },
          ...(run === 1 && { dash: DASH }),
        };
      }),
    );
    return {
      width: 200,
      height: 100,
      legend: { show: false },
      cursor: { sync: { key: "steps" }, drag: { x: false, y: false }, y: false, points: { size: 5 } },
      padding: [8, 18, 0, 0],
      scales: {
        x: { time: false, range: () => this.#span() },
        y: {
          range: this.group.range
            ? () => this.group.range!
            : (_, low, high) => range(low, this.group.unit === "ms" ? this.#later(high) : high),
        },
      },
      axes: [
        { ...axis, ...named("time in s"), size: 20, space: 50, values: (_, ticks) => ticks.map((each) => `${+each.toFixed(3)}`) },
        {
          ...axis,
          ...(unit && unit !== "1" && named(`in ${unit}`)),
          size: 40,
          space: 22,
          values: (_, ticks) => ticks.map((each) => `${+each.toPrecision(6)}`),
        },
      ],
      series: [{}, ...series],
      hooks: {
        setCursor: [() => this.#write()],
        draw: [(plot) => this.#mark(plot)],
      },
    };
  }

  /** Of the horizontal axis, in s. */
  #span(): [number, number] {
    const { first, end, rate_hz } = this.#shown;
    return [first / rate_hz, Math.max((end - 1) / rate_hz, first / rate_hz + LEAST_S)];
  }

  /** The largest value of all steps but the first, which takes long because everything is made there. */
  #later(high: number | null): number | null {
    const [, ...curves] = this.#plot.data;
    const later = curves.flatMap((curve) => (this.#shown.first === 0 ? Array.from(curve).slice(1) : [])).filter((each) => each != null);
    return later.length ? Math.max(...later) : high;
  }

  #mark(plot: uPlot): void {
    const { marked, step, rate_hz } = this.#shown;
    if (!marked) return;
    const x = Math.round(plot.valToPos(step / rate_hz, "x", true));
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.setLineDash([]);
    ctx.strokeStyle = "#ffd166";
    ctx.lineWidth = 1.5 * (window.devicePixelRatio || 1);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }
}

function named(label: string): Partial<uPlot.Axis> {
  return { label, labelFont: FONT, labelSize: 14, labelGap: 0 };
}

/** Points without neighbours, which no line would show: values that come every few steps. */
function alone(plot: uPlot, series: number): number[] {
  const values = plot.data[series];
  const found: number[] = [];
  for (let k = 0; k < values.length; k++) {
    if (values[k] != null && values[k - 1] == null && values[k + 1] == null) found.push(k);
  }
  return found;
}

/** Of the vertical axis: zero is in it, and curves keep off the upper border. */
function range(low: number | null, high: number | null): [number, number] {
  if (low === null || high === null) return [0, 1];
  const [from, to] = [Math.min(0, low), Math.max(0, high)];
  const room = (to - from || 1) * 0.08;
  return [from < 0 ? from - room : 0, to > 0 || from === to ? to + room : 0];
}

/** Value of a curve at a step, or shortly before it, as some are not evaluated in each step. */
function lately(curve: Curve, rows: Rows, step: number): number {
  const at = valuesOf(curve, rows);
  for (let back = 0; back < Math.min(LATELY, step + 1); back++) {
    const value = at(step - back);
    if (!Number.isNaN(value)) return value;
  }
  return Number.NaN;
}
