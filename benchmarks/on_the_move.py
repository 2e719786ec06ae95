"""How well symbols lie on the road while the car drives or nods, by what its sensors know: `python benchmarks/on_the_move.py [--quick]`.

Mean intersection over union after step 10 (docs/control.md, "On the move"). Sensors are those of `driving`, noisy and late; the same in
time; or one sample a step without errors, in time. Beside them stands what drawing for the true road from the body's true pose gives: the
bound.
"""

import sys
from argparse import Namespace
from typing import Any

import numpy as np
from bench import run, show

from luxloop import Simulation, load

BOUND = "true road and pose"


def mean_iou(given: Namespace, row: str, column: str) -> float:
    """Mean over the steps from `given.from_step` on."""
    controller, *changes = given.columns[column]
    keys = (f"functions.symbol.controller={{name='{controller}'}}", f"steps={given.steps}")
    simulation = Simulation.prepare(load("driving", (*given.rows[row], *changes, *keys)))
    symbols = [result.symbol for result in simulation.evaluations()]
    iou = [float(each.causes["iou_true"] if column == BOUND else each.metrics.iou) for each in symbols]
    return float(np.mean(iou[given.from_step :]))


def measure(given: Namespace) -> dict[str, Any]:
    if wrong := set(given.only) - given.rows.keys():
        sys.exit(f"--only: unknown {', '.join(wrong)}; known are {', '.join(given.rows)}")
    found = {row: {column: mean_iou(given, row, column) for column in given.columns} for row in given.only}
    show("Mean IoU", found)
    return {"steps": given.steps, "results": found}


if __name__ == "__main__":
    run(measure, __doc__, "only")
