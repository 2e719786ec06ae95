"""How well symbols lie on the road while the car drives or nods, by what its sensors know: `python benchmarks/on_the_move.py [--quick]`.

Mean intersection over union after step 10 (docs/control.md, "On the move"). Sensors are those of `driving`, noisy and a step late; the
same in time; or without errors, in time. Beside them stands what drawing for the true road from the body's true pose gives: the bound.
"""

from argparse import Namespace
from typing import Any

import numpy as np
import torch
from bench import run, show
from torch import Tensor

from luxloop.controllers.symbol.heights.feedforward import height_map_of
from luxloop.controllers.symbol.heights.height_controller import HeightControllerParams, region_of
from luxloop.controllers.symbol.heights.height_map import drawn_on
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import camera_view
from luxloop.perception.egomotion import Ego
from luxloop.world.frames import inverse, transform

STEPS, FROM = 60, 10
NOD = "vehicle.oscillation={{pitch_deg={}, rate_hz=1.2}}"
ROUGH = "road={kind='iso8608', roughness_class='D', seed=15}"
SPEED = "vehicle.course=[{{speed_m_s={}}}]"
ROWS = {f"rough, class D, {speed} m/s": (ROUGH, SPEED.format(speed)) for speed in (5, 10, 20)} | {
    f"flat, 10 m/s, nods by {deg}°": ("road.kind='flat'", SPEED.format(10), NOD.format(deg)) for deg in (0.2, 1)
}
BOUND = "true road and pose"
COLUMNS = {
    **{name: (name, ()) for name in ("open", "thesis_pid", "luxloop")},
    "luxloop, in time": ("luxloop", tuple(f"sensors.{sensor}.delay_s=0" for sensor in ("wheels", "gyro", "attitude"))),
    "luxloop, exact": ("luxloop", ("sensors={}",)),
    BOUND: ("open", ()),
}


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
        return drawn_on(relief, torch.stack(lamps).float(), self.symbol, inverse(now.T_ground_body))

    def step(self, state: int, observation: Observation) -> int:
        return state + 1


def iou(changes: tuple[str, ...], column: str, steps: int) -> np.ndarray:
    """Of each step, 0 where there is none."""
    controller, more = COLUMNS[column]
    keys = (f"functions.symbol.controller={{name='{controller}'}}", f"steps={steps}")
    simulation = Simulation.prepare(load("driving", (*changes, *more, *keys)))
    if column == BOUND:
        simulation = simulation.with_controller(TruePose(simulation))
    return np.nan_to_num([float(result.symbol.metrics.iou) for result in simulation.evaluations()])


def measure(given: Namespace) -> dict[str, Any]:
    steps, begin = (2, 0) if given.quick else (STEPS, FROM)
    found = {
        row: {column: float(iou(ROWS[row], column, steps)[begin:].mean()) for column in COLUMNS}
        for row in (list(ROWS)[-1:] if given.quick else given.only or ROWS)
    }
    show("Mean IoU", found)
    return {"steps": steps, "results": found}


if __name__ == "__main__":
    run(measure, __doc__, only={"nargs": "+", "metavar": "ROW", "choices": list(ROWS), "help": "these rows alone"})
