"""How fast and how well the thesis' controller settles: `python benchmarks/convergence.py [--json FILE] [--quick]`.

All four symbols, each from its own start, on procedural roads, and the shipped scenarios on measured ones; beside each the open loop.
Prints the tables of docs/results/convergence.md.
"""

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from bench import run, show
from side_by_side import DARK, World, compare, series

from luxloop.loop.recording.summary import AXES, END
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load

SYMBOLS = ("distance_warning", "chevrons", "snowflake", "warning_triangle")
ROADS, HARD_ROADS = ("flat", "bumps", "grade", "mixed"), ("speed_bump", "curb", "pothole", "iso8608")
SCANS = ("belgian_block", "half_round_bar", "torsion_track", "rough_course")
BIRDSEYE = ("functions.symbol.features.view='birdseye'", "functions.symbol.features.shape='moments'")
GAINS = "functions.symbol.controller"
VIEWS = {
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


def cases(quick: bool) -> Iterator[tuple[str, str, Scenario]]:
    """(table, road, scenario) of every run."""
    for symbol in SYMBOLS:
        for view, overrides in VIEWS.items():
            for road in ROADS[:1] if quick else ROADS:
                yield view, road, load(symbol, [f"road={{kind='{road}'}}", *overrides])
        for road in () if quick else HARD_ROADS:
            yield "harder roads, raw image, quadrants", road, load(symbol, [f"road={{kind='{road}'}}"])
        start = load(symbol).symbol.start_pose
        keys = (f"functions.symbol.image='{symbol}'", f"functions.symbol.start.x_m={start.x_m}", f"functions.symbol.start.y_m={start.y_m}")
        for name in () if quick else SCANS:
            if data.present(load(name).road.file) is not None:
                yield "measured roads, raw image, quadrants", name, load(name, keys)


def span(values: Sequence[float | None], form: str = "g") -> str:
    """From the least to the largest value."""
    known = [value for value in values if value is not None]
    return "–".join(dict.fromkeys(f"{value:{form}}" for value in (min(known), max(known)))) if known else "–"


def line(runs: Sequence[Mapping[str, Mapping[str, Any]]]) -> dict[str, str]:
    """A row of a table. runs: by symbol, of the open loop and the thesis' controller (`side_by_side.compare`)."""
    own = [each["thesis_pid"] for each in runs]
    settle = [each["settle_step"] for each in own]
    errors = [abs(np.stack([series(each, axis, DARK)[-END:].mean() for each in own])).max() for axis in AXES]
    return {
        "settle": span(settle) + (f", {settle.count(None)} never" if None in settle else ""),
        "overshoot %": span([each["overshoot_percent"] for each in own], ".0f"),
        "error %": " / ".join(f"{error:.1f}" for error in errors),
        "IoU open": span([each["open"]["iou"][-1] for each in runs], ".2f"),
        "IoU": span([each["iou"][-1] for each in own], ".2f"),
    }


def measure(given: Namespace) -> dict[str, Any]:
    runs = {}
    for part, road, scenario in cases(given.quick):
        tables = {"open": {"name": "open"}, "thesis_pid": scenario.symbol.controller.model_dump(mode="json")}
        runs.setdefault(part, {}).setdefault(road, []).append(compare(**World("", {}, scenario, tables).parameters)["metrics"])
    for part, roads in runs.items():
        show(part, {road: line(each) for road, each in roads.items()})
    lost = sum(sum(each["thesis_pid"]["lost"]) for roads in runs.values() for symbols in roads.values() for each in symbols)
    print(f"\nSteps in which a symbol was lost: {lost}")
    return {"runs": runs, "lost": lost}


if __name__ == "__main__":
    run(measure, __doc__)
