"""How fast and how well the thesis' controller settles: `python benchmarks/convergence.py [--json FILE] [--quick]`.

All four symbols, each from its own start, on procedural roads, and the shipped scenarios on measured ones; beside each the open loop.
Prints the tables of docs/results/convergence.md.
"""

from argparse import Namespace
from collections.abc import Iterator
from typing import Any

from bench import run, show

from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import summarise
from luxloop.loop.report.terminal import number
from luxloop.loop.run import prepare
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.simulation.columns import of_one

SYMBOLS = ("distance_warning", "chevrons", "snowflake", "warning_triangle")
ROADS, HARD_ROADS = ("flat", "bumps", "grade", "mixed"), ("speed_bump", "curb", "pothole", "iso8608")
SCANS = ("belgian_block", "half_round_bar", "torsion_track", "rough_course")
BIRDSEYE = ("functions.symbol.features.view='birdseye'", "functions.symbol.features.shape='moments'")
GAINS = "functions.symbol.controller"
VIEWS: dict[str, list[str]] = {
    "raw image, quadrants": [],
    "bird's-eye view, second moments, 1.4 times the thesis' rotation gains": [
        *BIRDSEYE,
        *(f"{GAINS}.{each}" for each in ("x_rate_m=1.45", "roll_rate_deg=1.0", "pitch_rate_deg=0.7")),
        f"{GAINS}.rotation={{kp=0.7, ki=0.14, kd=0.14, tracking_steps=2.2}}",
    ],
    "bird's-eye view, second moments, the thesis' gains": [
        *BIRDSEYE,
        *(f"{GAINS}.{each}" for each in ("x_rate_m=1.45", "roll_rate_deg=0.6", "pitch_rate_deg=0.42")),
        f"{GAINS}.rotation={{kp=0.5, ki=0.1, kd=0.1, tracking_steps=1.9}}",
    ],
}


def cases(quick: bool) -> Iterator[tuple[str, str, str, Scenario]]:
    """(table, road, symbol, scenario) of every run."""
    for symbol in SYMBOLS:
        for view, overrides in VIEWS.items():
            for road in ROADS[:1] if quick else ROADS:
                yield view, road, symbol, load(symbol, [f"road={{kind='{road}'}}", *overrides])
        for road in () if quick else HARD_ROADS:
            yield "harder roads, raw image, quadrants", road, symbol, load(symbol, [f"road={{kind='{road}'}}"])
        for name in () if quick else SCANS:
            if data.present(load(name).road.file) is not None:
                start = load(symbol).symbol.start_pose
                start_keys = [f"functions.symbol.start.{axis}={getattr(start, axis)}" for axis in ("x_m", "y_m")]
                yield "measured roads, raw image, quadrants", name, symbol, load(name, [f"functions.symbol.image='{symbol}'", *start_keys])


def summary(scenario: Scenario) -> dict[str, Any]:
    """The summary of one scenario's trajectory."""
    simulation = prepare(scenario, "cpu")
    results, symbol = list(simulation.evaluations()), simulation.symbol
    target = simulation.of_all(symbol, symbol.projector.light(symbol.projector.target))
    open_loop = symbol.judge.verdict(target, results[-1].time_s)
    table = of_one(table_of([row(result) for result in results], schema(simulation)), "symbol")
    return summarise(table, symbol.params.name, float(open_loop.iou))


def span(values: list[float | None], form: str = "g") -> str:
    """From the least to the largest value."""
    known = [value for value in values if value is not None]
    return "–".join(dict.fromkeys(f"{value:{form}}" for value in (min(known), max(known)))) if known else "–"


def line(runs: list[dict[str, Any]]) -> dict[str, str]:
    """A row of a table."""
    settle = [each["settle_step"] for each in runs]
    never = f", {settle.count(None)} never" if None in settle else ""
    axes = ([abs(each["centroid_error_percent"][k]) for each in runs if each["centroid_error_percent"][k] is not None] for k in (0, 1))
    error = " / ".join(number(max(axis, default=None), ".1f") for axis in axes)
    overshoot = span([each["overshoot_percent"] for each in runs], ".0f")
    ious = {name: span([each[key] for each in runs], ".2f") for name, key in (("IoU open", "iou_open"), ("IoU", "iou_final"))}
    return {"settle": span(settle) + never, "overshoot %": overshoot, "error %": error, **ious}


def measure(given: Namespace) -> dict[str, Any]:
    runs: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for part, road, symbol, each in cases(given.quick):
        runs.setdefault(part, {}).setdefault(road, []).append({"symbol": symbol, **summary(each)})
    for part, roads in runs.items():
        show(part, {road: line(each) for road, each in roads.items()})
    lost = sum(each["lost_steps"] for roads in runs.values() for symbols in roads.values() for each in symbols)
    print(f"\nSteps in which a symbol was lost: {lost}")
    return {"runs": runs, "lost": lost}


if __name__ == "__main__":
    run(measure, __doc__)
