"""IoU with and without warp and supervisor, and after a survey, on four roads and behind a box: `python benchmarks/symbol_stages.py`.

Prints the table of docs/control.md.
"""

import itertools
from argparse import Namespace
from typing import Any

from bench import run, show
from side_by_side import World, compare, series

from luxloop.loop.scenario.model import load

STEPS, LAST = 30, 10
BOX = '[{kind="box", name="box", size_m=[0.4, 0.5, 0.3], albedo=0.2, track=[{position_m=[15.5, 0.2, 0.0]}]}]'
ROADS = {
    "mixed": ("snowflake", ()),
    "bumps": ("snowflake", ("road.kind=bumps",)),
    "speed bump": ("speed_bump", ()),
    "curb": ("curb", ()),
    "box on a flat road": ("snowflake", ("road.kind=flat", f"objects={BOX}")),
}
STAGES = {"alone": {}, "warp": {"warp": {}}, "both": {"warp": {}, "supervisor": {}}}
CONTROLLERS = {"open loop": {"name": "open"}, "survey": {"name": "feedforward", "survey": True}} | {
    f"`{name}` {stage}": {"name": name, **tables}
    for name, (stage, tables) in itertools.product(("thesis_pid", "gauss_newton"), STAGES.items())
}


def measure(given: Namespace) -> dict[str, Any]:
    roads, steps = ({"mixed": ROADS["mixed"]}, 2) if given.quick else (ROADS, STEPS)
    controllers = dict(list(CONTROLLERS.items())[:: 4 if given.quick else 1])
    found = {}
    for road, case in roads.items():
        metrics = compare(**World(road, {}, load(*case, steps=steps), controllers).parameters)["metrics"]
        found[road] = {name: float(series(each, "iou", 0.0)[-LAST:].mean()) for name, each in metrics.items()}
    show(f"IoU of the last {LAST} of {steps} steps", found)
    return {"iou": found}


if __name__ == "__main__":
    run(measure, __doc__)
