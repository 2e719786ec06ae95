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

from luxloop import Scenario, load
from luxloop.loop.recording.summary import AXES, END
from luxloop.loop.scenario import data


def scenarios(given: Namespace) -> Iterator[tuple[str, str, Scenario]]:
    """(table, road, scenario) of every run."""
    for symbol in given.symbols:
        for table, (roads, *changes) in given.tables.items():
            for road in roads:
                yield table, road, load(symbol, [f"road={{kind='{road}'}}", *changes])
        start = load(symbol).symbol.start_pose
        keys = (f"functions.symbol.image='{symbol}'", f"functions.symbol.start={{x_m={start.x_m}, y_m={start.y_m}}}")
        for name in given.scans:
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
    for part, road, scenario in scenarios(given):
        tables = {"open": {"name": "open"}, "thesis_pid": scenario.symbol.controller.model_dump(mode="json")}
        runs.setdefault(part, {}).setdefault(road, []).append(compare(**World("", {}, scenario, tables).parameters)["metrics"])
    for part, roads in runs.items():
        show(part, {road: line(each) for road, each in roads.items()})
    lost = sum(sum(each["thesis_pid"]["lost"]) for roads in runs.values() for symbols in roads.values() for each in symbols)
    print(f"\nSteps in which a symbol was lost: {lost}")
    return {"runs": runs, "lost": lost}


if __name__ == "__main__":
    run(measure, __doc__)
