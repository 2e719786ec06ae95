"""How well symbols lie on the road while the car drives or nods, by what its sensors know: `python benchmarks/on_the_move.py [--quick]`.

Mean intersection over union after step 10 (docs/control.md, "On the move"). Sensors are those of `driving`, noisy and a step late; the
same in time; or without errors, in time. Beside them stands what drawing for the true road from the body's true pose gives: the bound.
"""

import sys
from argparse import Namespace
from typing import Any

import numpy as np
import torch
from bench import run, show
from torch import Tensor

from luxloop import Ego, Observation, ProjectionCommand, Simulation, load
from luxloop.controllers.symbol.heights.feedforward import height_map_of
from luxloop.controllers.symbol.heights.height_controller import HeightControllerParams, region_of
from luxloop.controllers.symbol.heights.height_map import draw_on
from luxloop.perception.camera import camera_view
from luxloop.world.frames import inverse, transform

BOUND = "true road and pose"


class TruePose:
    """A controller that draws for the true road from the body's true pose; its state is the step."""

    def __init__(self, simulation: Simulation) -> None:
        self.road, self.symbol, projector = simulation.scenario.road, simulation.scenario.symbol, simulation.symbol.projector
        self.motion, self.period_s = simulation.world.motion, 1 / simulation.scenario.rate_hz
        lamps = [module.T_body_headlight[:3, 3].double() for module in projector.modules]
        self.eyes = torch.stack([camera_view(simulation.scenario.camera).origin, *lamps], 1)

    def start(self, pose: Tensor) -> int:
        return 0

    def projection(self, state: int, ego: Ego | None) -> ProjectionCommand:
        now = self.motion.at(state * self.period_s)
        eye, *lamps = transform(now.T_ground_body, self.eyes).T
        region = region_of(self.symbol, *HeightControllerParams().beyond_m)
        relief = height_map_of(self.road.z, region, eye, T_ground_plane=now.T_world_ground)
        return draw_on(relief, torch.stack(lamps).float(), self.symbol, inverse(now.T_ground_body))

    def step(self, state: int, observation: Observation) -> int:
        return state + 1


def mean_iou(given: Namespace, row: str, column: str) -> float:
    """Mean over the steps from `given.from_step` on, 0 where there is none."""
    controller, *changes = given.columns[column]
    keys = (f"functions.symbol.controller={{name='{controller}'}}", f"steps={given.steps}")
    simulation = Simulation.prepare(load("driving", (*given.rows[row], *changes, *keys)))
    if column == BOUND:
        simulation = simulation.with_controller(TruePose(simulation))
    iou = np.nan_to_num([float(result.symbol.metrics.iou) for result in simulation.evaluations()])
    return float(iou[given.from_step :].mean())


def measure(given: Namespace) -> dict[str, Any]:
    if wrong := set(given.only) - given.rows.keys():
        sys.exit(f"--only: unknown {', '.join(wrong)}; known are {', '.join(given.rows)}")
    found = {row: {column: mean_iou(given, row, column) for column in given.columns} for row in given.only}
    show("Mean IoU", found)
    return {"steps": given.steps, "results": found}


if __name__ == "__main__":
    run(measure, __doc__, "only")
