"""How well symbols lie on the road while the car drives or nods, by what its sensors know: `python benchmarks/on_the_move.py [--quick]`.

Mean intersection over union after step 10 (docs/control.md, "On the move"). Sensors are those of `driving`, noisy and a step late; the
same in time; or without errors, in time. Beside them stands what drawing for the true road from the body's true pose gives: the bound.
"""

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from bench import machine, on_one_thread
from torch import Tensor

from luxloop.controllers.symbol.heights.feedforward import height_map_of
from luxloop.controllers.symbol.heights.height_controller import HeightControllerParams, region_of
from luxloop.controllers.symbol.heights.height_map import drawn_on
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import camera_view
from luxloop.perception.egomotion import Ego
from luxloop.world.frames import inverse, transform
from luxloop.world.roads.base import Road
from luxloop.world.scene.vehicle import Motion

STEPS, FROM = 60, 10
ROAD_SEEDS = {"C": 0, "D": 15}
NOD = "vehicle.oscillation={{pitch_deg={}, rate_hz=1.2}}"
ROUGH = "road={{kind='iso8608', roughness_class='{}', seed={}}}"
SPEED = "vehicle.course=[{{speed_m_s={}}}]"
ROWS = {
    **{
        f"rough, class {kind}, {speed} m/s": (ROUGH.format(kind, seed), SPEED.format(speed))
        for kind, seed in ROAD_SEEDS.items()
        for speed in (5, 10, 20)
    },
    **{f"flat, 10 m/s, nods by {deg}°": ("road.kind='flat'", SPEED.format(10), NOD.format(deg)) for deg in (0.2, 1)},
}
IN_TIME = tuple(f"sensors.{sensor}.delay_s=0" for sensor in ("wheels", "gyro", "attitude"))
EXACT = ("sensors={}",)
BOUND = "true road and pose"
COLUMNS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "open": ("open", ()),
    "thesis_pid": ("thesis_pid", ()),
    "luxloop": ("luxloop", ()),
    "luxloop, in time": ("luxloop", IN_TIME),
    "luxloop, exact": ("luxloop", EXACT),
    BOUND: ("open", ()),
}


@dataclass(frozen=True)
class Knowing:
    """Draws for the true road from where the body truly is; its state is the step."""

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


def iou(changes: tuple[str, ...], column: str, steps: int) -> list[float]:
    """Of each step."""
    controller, more = COLUMNS[column]
    held = f"functions.symbol.controller={{name='{controller}'}}"
    simulation = Simulation.prepare(load("driving", (*changes, *more, held, f"steps={steps}")))
    if column == BOUND:
        world, scenario = simulation.world, simulation.scenario
        knowing = Knowing(simulation.symbol.sensor, cast(Road, scenario.road), world.motion, 1 / scenario.rate_hz)
        simulation = simulation.with_controller(knowing)
    return [float(result.symbol.verdict.iou) for result in simulation.run()]


def main() -> None:
    """Measure, show."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--only", nargs="+", metavar="ROW", choices=list(ROWS), help="these rows alone")
    parser.add_argument("--quick", action="store_true", help="two steps of the last row, to see that it works")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    steps, begin = (2, 0) if arguments.quick else (STEPS, FROM)
    rows = [list(ROWS)[-1]] if arguments.quick else arguments.only or list(ROWS)
    where, found = machine("torch", "numpy"), dict[str, dict[str, Any]]()
    for row in rows:
        each = {column: iou(ROWS[row], column, steps) for column in COLUMNS}
        found[row] = {column: float(np.nan_to_num(values)[begin:].mean()) for column, values in each.items()}
        worst = float(np.nan_to_num(np.subtract(each["open"], each["luxloop"]))[begin:].max())
        found[row]["luxloop below open, worst step"] = worst
        print(json.dumps({row: found[row]}), flush=True)
    tables.show(tables.plain(("mean IoU", *COLUMNS), ((row, *(f"{found[row][column]:.2f}" for column in COLUMNS)) for row in rows)))
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": where, "steps": steps, "results": found}, indent=1) + "\n")


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS", "LP_NUM_THREADS")
    main()
