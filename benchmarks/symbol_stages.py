"""IoU with and without warp and supervisor, and after a survey, on four roads and behind a box: `python benchmarks/symbol_stages.py`.

Prints the table of docs/control.md.
"""

from argparse import Namespace
from typing import Any

from bench import run, show
from side_by_side import World, compare, series

from luxloop import load


def measure(given: Namespace) -> dict[str, Any]:
    found = {}
    for road, (name, *changes) in given.roads.items():
        metrics = compare(**World(road, {}, load(name, changes, steps=given.steps), given.controllers).parameters)["metrics"]
        found[road] = {name: float(series(each, "iou", 0.0)[-given.last :].mean()) for name, each in metrics.items()}
    show(f"IoU of the last {given.last} of {given.steps} steps", found)
    return {"iou": found}


if __name__ == "__main__":
    run(measure, __doc__)
