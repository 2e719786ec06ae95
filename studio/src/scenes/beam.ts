// The verdict of a regulation on the light at the wall: rule and side, and the list of its points.

import { brief } from "../brief.ts";
import { fill, h, select } from "../dom.ts";
import type { BeamPoint } from "../protocol.ts";
import type { Session } from "../session.ts";
import type { Side, Studio } from "../state.ts";

const AGAIN_MS = 1000; // between two verdicts while the light changes
const PATIENCE_MS = 10000;

export function beamControls(store: Studio, session: Session, bar: HTMLElement, body: HTMLElement): void {
  const rule = select("Regulation", [["", "no rule"]], (value) => store.set({ rule: value }));
  const side = select(
    "Lamp",
    [
      ["left", "left lamp"],
      ["right", "right lamp"],
    ],
    (value) => store.set({ side: value as Side }),
  );
  const controls = h("span", { class: "beam-controls" }, rule, side);
  const list = h("div", { class: "beam-list", tabindex: 0, role: "region", "aria-label": "Points of the regulation" });
  bar.append(controls);
  body.append(list);

  let asked_ms = Number.NEGATIVE_INFINITY;
  let waiting = false;
  let again: ReturnType<typeof setTimeout> | null = null;
  const ask = () => {
    again = null;
    const state = store.state;
    if (state.viewpoint !== "wall" || !state.rule || state.link !== "open") return;
    asked_ms = performance.now();
    waiting = true;
    for (const run of state.runs.keys()) session.send({ type: "beam", run, rule: state.rule, side: state.side, step: state.scrub });
  };
  store.on(["viewpoint", "rule", "side", "scenario"], () => {
    if (again !== null) clearTimeout(again);
    ask();
  });
  store.on(["step_version"], ({ viewpoint, rule: chosen }) => {
    if (again !== null || viewpoint !== "wall" || !chosen) return;
    const since_ms = performance.now() - asked_ms;
    if (waiting && since_ms < PATIENCE_MS) return;
    again = setTimeout(ask, Math.max(0, AGAIN_MS - since_ms));
  });
  store.on(["beams"], () => {
    waiting = false;
  });

  store.on(["choices"], ({ choices }) => fill(rule, [["", "no rule"], ...(choices?.rules ?? []).map((id) => [id, id] as const)]));
  store.on(["viewpoint", "rule", "side", "beams", "scenario"], (state) => {
    controls.hidden = state.viewpoint !== "wall";
    rule.value = state.rule;
    side.value = state.side;
    const shown = state.viewpoint === "wall" && state.rule !== "";
    const beams = state.beams.filter((each) => each?.rule === state.rule && each.side === state.side);
    list.hidden = !shown || beams.length === 0;
    if (list.hidden) return;
    const runs = state.scenario?.runs.length ?? 1;
    list.replaceChildren(
      table(state.beams.map((each) => (each?.rule === state.rule && each.side === state.side ? each.points : [])).slice(0, runs)),
    );
  });
}

function table(runs: BeamPoint[][]): HTMLElement {
  const points = new Map(runs.flat().map((point) => [point.id, point]));
  const missed = runs.flat().filter(({ passed }) => passed === false).length;
  const values = runs.map((_, run) => h("th", { scope: "col", class: "number" }, runs.length > 1 ? `run ${run + 1}` : "value"));
  const units = [...new Set([...points.values()].map(({ unit }) => unit))];
  const rows = [...points.values()].map(({ id, unit, limit }) => {
    const cells = runs.map((each) => {
      const point = each.find((other) => other.id === id);
      const verdict = point?.passed === false ? "failed" : point?.passed === true ? "passed" : "open";
      const sign = { failed: "\u2717", passed: "\u2713", open: "" }[verdict];
      return h(
        "td",
        { class: `number ${verdict}`, title: verdict === "open" ? "no limit" : verdict },
        point ? brief(point.value) : "-",
        h("span", { class: "sign", "aria-label": verdict === "open" ? "" : verdict }, sign),
        units.length > 1 && h("span", { class: "unit" }, unit),
      );
    });
    return h("tr", {}, h("th", { scope: "row" }, id), ...cells, h("td", {}, limit));
  });
  return h(
    "table",
    {},
    h(
      "caption",
      {},
      `${missed ? `${missed} ${missed === 1 ? "point fails" : "points fail"}` : "all points pass"}${units.length === 1 ? `; values in ${units[0]}` : ""}`,
    ),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "point"), ...values, h("th", { scope: "col" }, "limit"))),
    h("tbody", {}, ...rows),
  );
}
