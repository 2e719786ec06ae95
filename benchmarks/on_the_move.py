"""How well symbols lie on the road while the car drives or nods, by what its sensors know: `python benchmarks/on_the_move.py [--quick]`.

Mean intersection over union after step 10 (docs/control.md, "On the move"). Sensors are those of `driving`, noisy and a step late; the
same in time; or without errors, in time. Beside them stands what drawing for the true road from the body's true pose gives: the bound.
"""

from argparse import Namespace
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from bench import run, show
from torch import Tensor

from luxloop.controllers.symbol.heights.feedforward import height_map_of
from luxloop.controllers.symbol.heights.height_controller import HeightControllerParams, region_of
from luxloop.controllers.symbol.heights.height_map import drawn_on
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import camera_view
from luxloop.perception.egomotion import Ego
from luxloop.world.frames import inverse, transform
from luxloop.world.roads.base import Road
from luxloop.world.scene.vehicle import Motion

STEPS, FROM = 60, 10
NOD = "vehicle.oscillation={{pitch_deg={}, rate_hz=1.2}}"
ROUGH = "road={{kind='iso8608', roughness_class='{}', seed={}}}"
SPEED = "vehicle.course=[{{speed_m_s={}}}]"
ROWS = {
    f"rough, class {kind}, {speed} m/s": (ROUGH.format(kind, seed), SPEED.format(speed))
    for kind, seed in {"C": 0, "D": 15}.items()
    for speed in (5, 10, 20)
} | {f"flat, 10 m/s, nods by {deg}°": ("road.kind='flat'", SPEED.format(10), NOD.format(deg)) for deg in (0.2, 1)}
BOUND = "true road and pose"
COLUMNS: dict[str, tuple[str, tuple[str, ...]]] = {
    **{name: (name, ()) for name in ("open", "thesis_pid", "luxloop")},
    "luxloop, in time": ("luxloop", tuple(f"sensors.{sensor}.delay_s=0" for sensor in ("wheels", "gyro", "attitude"))),
    "luxloop, exact": ("luxloop", ("sensors={}",)),
    BOUND: ("open", ()),
}


@dataclass(frozen=True)
class TruePose:
    """A controller that draws for the true road from the body's true pose; its state is the step."""

    sensor: SymbolSensor
    road: Road
    motion: Motion
    period_s: float

    def start(self, pose: Tensor) -> int:
        return 0

    def projection(self, state: int, ego: Ego | None) -> ProjectionCommand:
        projector, now = self.sensor.projector, self.motion.at(state * self.period_s)
        symbol = projector.params
        lamps = torch.stack([module.T_world_headlight[:3, 3].double() for module in projector.modules])
        ends = torch.stack([camera_view(self.sensor.camera).origin, *lamps], 1)
        there = transform(now.T_ground_body, ends).T
        relief = height_map_of(
            self.road.z, region_of(symbol, *HeightControllerParams().beyond_m), there[0], T_ground_plane=now.T_world_ground
        )
        return drawn_on(relief, there[1:].float(), symbol, inverse(now.T_ground_body))

    def step(self, state: int, observation: Observation) -> int:
        return state + 1


def iou(changes: tuple[str, ...], column: str, steps: int) -> np.ndarray:
    """Of each step, 0 where there is none."""
    controller, more = COLUMNS[column]
    keys = (f"functions.symbol.controller={{name='{controller}'}}", f"steps={steps}")
    simulation = Simulation.prepare(load("driving", (*changes, *more, *keys)))
    if column == BOUND:
        world, scenario = simulation.world, simulation.scenario
        bound = TruePose(simulation.symbol.sensor, cast(Road, scenario.road), world.motion, 1 / scenario.rate_hz)
        simulation = simulation.with_controller(bound)
    return np.nan_to_num([float(result.symbol.verdict.iou) for result in simulation.evaluations()])


def measure(given: Namespace) -> dict[str, Any]:
    steps, begin = (2, 0) if given.quick else (STEPS, FROM)
    found = dict[str, dict[str, float]]()
    for row in list(ROWS)[-1:] if given.quick else given.only or ROWS:
        each = {column: iou(ROWS[row], column, steps)[begin:] for column in COLUMNS}
        worst = float((each["open"] - each["luxloop"]).max())
        found[row] = {column: float(values.mean()) for column, values in each.items()} | {"luxloop below open, worst step": worst}
    show("Mean IoU", found)
    return {"steps": steps, "results": found}


if __name__ == "__main__":
    run(measure, __doc__, only={"nargs": "+", "metavar": "ROW", "choices": list(ROWS), "help": "these rows alone"})
