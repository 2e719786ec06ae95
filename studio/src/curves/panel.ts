// Curves of the columns of all runs, over the last minute or the whole run.

import { csv, download, h, toggle } from "../dom.ts";
import { panel } from "../panels.ts";
import type { Column } from "../protocol.ts";
import type { Session } from "../session.ts";
import { newestStep, type Studio } from "../state.ts";
import { Chart } from "./chart.ts";
import { columnList } from "./columns.ts";
import { defaults, groups } from "./groups.ts";

const REDRAW_MS = 100;
const REST = 4; // times what drawing took pass until the next, so that it takes a fifth of the time at most
const MINUTE_S = 60;

export function curvesPanel(store: Studio, session: Session): HTMLElement {
  const { element, bar, body } = panel(store, "curves", "Curves");
  const empty = h("p", { class: "empty" });
  let charts: Chart[] = [];
  let chosen: Set<string> | null = null;
  let whole = false;
  let columns: Column[] = [];
  let timer: ReturnType<typeof setTimeout> | null = null;
  let drawn_ms = 0;
  let took_ms = 0;

  const draw = () => {
    timer = null;
    drawn_ms = performance.now();
    const { runs, scenario, scrub } = store.state;
    if (!scenario || element.hidden) return;
    const end = Math.max(0, ...runs.map(({ rows }) => rows.count));
    const first = whole ? 0 : Math.max(0, end - Math.ceil(MINUTE_S * scenario.rate_hz));
    const step = scrub ?? newestStep(store.state);
    for (const chart of charts) chart.draw({ runs, rate_hz: scenario.rate_hz, first, end, step, marked: scrub !== null });
    took_ms = performance.now() - drawn_ms;
  };
  const redraw = () => {
    if (timer === null) timer = setTimeout(draw, Math.max(0, Math.max(REDRAW_MS, REST * took_ms) - (performance.now() - drawn_ms)));
  };
  const rebuild = () => {
    for (const chart of charts) chart.dispose();
    const { scenario } = store.state;
    const now = chosen ?? defaults(columns);
    const pick = (step: number) => session.scrub(Math.max(0, Math.min(step, newestStep(store.state))));
    charts = groups(columns, now).map((group) => new Chart(group, scenario?.runs.length ?? 1, pick));
    body.replaceChildren(...charts.map((each) => each.element), empty);
    empty.hidden = charts.length > 0;
    empty.textContent = columns.length > 0 ? "No columns are chosen." : "No steps yet.";
    list.show(columns, now);
    redraw();
  };
  const list = columnList((names) => {
    chosen = names;
    rebuild();
  });
  const span = toggle("whole run", "Draw the whole run, or its last minute", (now) => {
    whole = now;
    span.show(now);
    redraw();
  });
  const save = h(
    "button",
    { title: "Download the columns drawn, of all steps, as CSV", onclick: () => download("curves.csv", all()) },
    "CSV",
  );
  const all = () => {
    const { runs, scenario } = store.state;
    const names = [...(chosen ?? defaults(columns))];
    const lines = runs.flatMap(({ rows }, run) =>
      Array.from({ length: rows.count }, (_, step) => [
        ...[run + 1, step, step / (scenario?.rate_hz ?? 1)],
        ...names.map((name) => rows.at(name, step)),
      ]),
    );
    return csv(["run", "step", "time_s", ...names], lines);
  };
  const runsKey = h("span", { class: "runs-key muted" });
  bar.append(runsKey, save, span.button, list.element);
  store.on(["scenario"], ({ scenario }) => {
    const all = (scenario?.runs ?? []).flatMap((run) => run.columns);
    columns = [...new Map(all.map((each) => [each.name, each])).values()];
    const [one, other] = scenario?.runs ?? [];
    runsKey.replaceChildren(...(other ? [`run 1, solid: ${one.label}; run 2, dashed: ${other.label}`] : []));
    rebuild();
  });
  store.on(["rows_version", "runs", "scrub", "maximised"], redraw);
  return element;
}
