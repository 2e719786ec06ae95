"""How fast and how well the thesis' controller pulls the symbols straight: `python benchmarks/convergence.py [--json FILE] [--quick]`.

All four symbols, each from its own start, on procedural roads, and the shipped scenarios on measured ones; beside each the open loop.
Writes docs/results/convergence.md.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import rich.progress

from luxloop.loop.recording.files import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import summarise
from luxloop.loop.report.terminal import markdown, number
from luxloop.loop.run import prepare
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.simulation.columns import of_one

SYMBOLS = ("distance_warning", "chevrons", "snowflake", "warning_triangle")
ROADS = ("flat", "bumps", "grade", "mixed")
HARD_ROADS = ("speed_bump", "curb", "pothole", "iso8608")
SCANS = ("belgian_block", "half_round_bar", "torsion_track", "rough_course")
VIEWS = {
    "raw image, quadrants": [],
    "bird's-eye view, second moments, 1.4 times the thesis' rotation gains": [
        "functions.symbol.features.view='birdseye'",
        "functions.symbol.features.shape='moments'",
        "functions.symbol.controller.x_rate_m=1.45",
        "functions.symbol.controller.roll_rate_deg=1.0",
        "functions.symbol.controller.pitch_rate_deg=0.7",
        "functions.symbol.controller.rotation={kp=0.7, ki=0.14, kd=0.14, tracking_steps=2.2}",
    ],
    "bird's-eye view, second moments, the thesis' gains": [
        "functions.symbol.features.view='birdseye'",
        "functions.symbol.features.shape='moments'",
        "functions.symbol.controller.x_rate_m=1.45",
        "functions.symbol.controller.roll_rate_deg=0.6",
        "functions.symbol.controller.pitch_rate_deg=0.42",
        "functions.symbol.controller.rotation={kp=0.5, ki=0.1, kd=0.1, tracking_steps=1.9}",
    ],
}
COLUMNS = ("road", "settle", "overshoot %", "error %", "IoU open", "IoU")
DOC = Path(__file__).parents[1] / "docs" / "results" / "convergence.md"


def measure(scenario: Scenario) -> dict[str, Any]:
    """Run one scenario without files; the summary of its trajectory."""
    simulation = prepare(scenario, "cpu")
    results, symbol = list(simulation.run()), simulation.symbol
    target = simulation.of_all(symbol, symbol.projector.light(symbol.projector.target))
    opened = symbol.judge.verdict(target, results[-1].time_s)
    table = of_one(table_of([row(result) for result in results], schema(simulation)), "symbol")
    return summarise(table, symbol.params.name, float(opened.iou))


def cases(quick: bool) -> list[tuple[str, str, str, Scenario]]:
    """(part of the table, road, symbol, scenario) of every run."""
    found = []
    for view, overrides in VIEWS.items():
        for road in ROADS[:1] if quick else ROADS:
            for symbol in SYMBOLS:
                found.append((view, road, symbol, load(symbol, [f"road={{kind='{road}'}}", *overrides])))
    if not quick:
        for road in HARD_ROADS:
            for symbol in SYMBOLS:
                found.append(("harder roads, raw image, quadrants", road, symbol, load(symbol, [f"road={{kind='{road}'}}"])))
        for name in SCANS:
            scenario = load(name)
            if data.present(scenario.road.file) is not None:
                for symbol in SYMBOLS:
                    start = load(symbol).symbol.start_pose
                    placed = load(
                        name,
                        [
                            f"functions.symbol.image='{symbol}'",
                            f"functions.symbol.start.x_m={start.x_m}",
                            f"functions.symbol.start.y_m={start.y_m}",
                        ],
                    )
                    found.append(("measured roads, raw image, quadrants", name, symbol, placed))
    return found


def document(rows: list[dict[str, Any]]) -> str:
    """The page: a row for each road, with what the symbols come to, from least to most."""
    lines = [
        "# Convergence",
        "",
        "How fast the thesis' controller converges. Made by `python benchmarks/convergence.py`; seed 0, 40 steps, camera 1280 x 720 px.",
        "Each of the four symbols starts as in its scenario, rolled by 5° and pitched by -2°. Figures are the range over the symbols;",
        "*error* is the largest of the centroid, along / across, in % of the symbol. *Open* is the open loop, *settle* as in",
        "[summaries](../recordings.md#summary).",
        "",
        "Goals on the first four roads: settle within 20 steps in the raw image, 15 in the bird's-eye view, overshoot at most 25 %,",
        "error at most 2 %. On the other roads, four degrees of freedom cannot compensate a step. With the thesis' gains an ideal",
        f"rotation loop needs 17 steps from 5°. Steps in which a symbol was lost: {sum(r['lost_steps'] for r in rows)}.",
    ]
    for part in dict.fromkeys(r["part"] for r in rows):
        own = [r for r in rows if r["part"] == part]
        cells = (_line(road, [r for r in own if r["road"] == road]) for road in dict.fromkeys(r["road"] for r in own))
        lines += ["", f"## {part[0].upper()}{part[1:]}", "", markdown(COLUMNS, cells, "lr")]
    return "\n".join(lines) + "\n"


def _line(road: str, rows: list[dict[str, Any]]) -> tuple[str, ...]:
    settled = [r["settle_step"] for r in rows if r["settle_step"] is not None]
    never = f", {len(rows) - len(settled)} never" if len(settled) < len(rows) else ""
    errors = ([abs(r["centroid_error_percent"][k]) for r in rows if r["centroid_error_percent"][k] is not None] for k in (0, 1))
    error = " / ".join(number(max(axis, default=None), ".1f") for axis in errors)
    overshoot, *ious = (
        _range([r[key] for r in rows], form) for key, form in (("overshoot_percent", ".0f"), ("iou_open", ".2f"), ("iou_final", ".2f"))
    )
    return (road, _range(settled) + never, overshoot, error, *ious)


def _range(values: list[float | None], form: str = "g") -> str:
    known = [value for value in values if value is not None]
    return "–".join(dict.fromkeys(f"{value:{form}}" for value in (min(known), max(known)))) if known else "–"


def main() -> None:
    """Run all cases, print progress, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the rows here")
    parser.add_argument("--quick", action="store_true", help="the flat road only, and do not write the page")
    arguments = parser.parse_args()
    rows = []
    for part, road, symbol, scenario in rich.progress.track(cases(arguments.quick), "runs"):
        rows.append({"part": part, "road": road, "symbol": symbol, **measure(scenario)})
    page = document(rows)
    if arguments.quick:
        print(page)
    else:
        DOC.write_text(page)
        print(f"written: {DOC}")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
