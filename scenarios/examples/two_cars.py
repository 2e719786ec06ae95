"""Two cars draw one symbol together, each with its share of the light and its own closed loop: `python two_cars.py [ROAD]`.

They stand side by side, 3 m apart, with one lamp and one camera each, on one uneven road. Each point of the symbol gets its illuminance
from both lamps, in proportion to what each can give there (T 7.5.1). The cars measure in turns: while one switches its symbol on and off,
the other's stays lit, so that the difference of the frames is the own light alone.

It takes parts of luxloop's internal packages, which may change.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

import luxloop
from luxloop.controllers.pixels.secondary import PotentialLight, shares
from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand, Warp
from luxloop.loop.simulation.simulated import SimulatedPlant
from luxloop.loop.simulation.world import World
from luxloop.world.frames import View

Lights = tuple[luxloop.Utilisation, ...]  # one a module
ASIDE_M = {"left": 1.5, "right": -1.5}  # of the cars, each with its lamp on its middle line
WANTED_LX = 4.0
SCENARIO = (
    "light.ambient_lx=0.1",
    "camera={sensitivity_e_per_cd_s_m2=500000.0, saturation_e=10000.0}",  # the other car's light adds its noise
    "headlight={model='idealised-332x1024', distance_m=3.0}",
    "functions.symbol.start={x_m=16.0, y_m=0.0, roll_deg=0.0, pitch_deg=0.0}",
    f"functions.symbol={{x_m=16.0, width_m=1.6, target='place', quantity='E_v', value={WANTED_LX}}}",
    "functions.symbol={image='chevrons', controller={name='luxloop'}}",
)


@dataclass(frozen=True)
class Sharing:
    """A symbol's controller that leaves the other car its share. lights: potential lights, the own one first."""

    controller: Any
    projector: Any
    lights: tuple[PotentialLight, PotentialLight]

    def start(self, pose: Tensor) -> Any:
        """State of the controller."""
        return self.controller.start(pose)

    def projection(self, state: Any, ego: Any) -> ProjectionCommand:
        """The controller's command, dimmed to the own share in each cell of the rectangle."""
        whole, params = self.controller.projection(state, ego), self.projector.params
        size = CELLS if whole.warp is None else whole.warp.dimming.shape[-2:]
        v, u = torch.meshgrid(*((torch.arange(n) + 0.5) / n for n in size), indexing="ij")
        plain = Warp(2 * torch.stack([u, v])[None] - 1, torch.ones(1, *size), (params.length_m, params.width_m))
        rectangle, warp = self.projector.rectangle(whole), plain if whole.warp is None else whole.warp
        origin, d1, d2 = (each[0, :, None] for each in (rectangle.origin, rectangle.d1, rectangle.d2))
        share = shares(self.lights, origin + d1 * u.flatten() + d2 * v.flatten())[0].view(1, *size)
        return replace(whole, warp=replace(warp, dimming=warp.dimming * share), data=whole)

    def step(self, state: Any, observation: luxloop.Observation) -> Any:
        """Step the controller, which knows its own command again."""
        shown = observation.shown
        return self.controller.step(state, replace(observation, shown=replace(shown, projection=shown.projection.data)))


class SharedRoad:
    """The plant of one car on a road that the other car lights, too.

    truth: the world with the own light alone. road: the world with both lights, the own one first. other: newest light of the other car.
    """

    def __init__(self, plant: SimulatedPlant, other: SimulatedPlant) -> None:
        self.truth, self.other = plant.world, tuple[luxloop.Utilisation, ...]()
        self.road = World(self.truth.scene, (*self.truth.modules, *other.world.modules), self.truth.camera, self.truth.source)
        self.plant = replace(plant, world=self.road)

    def start(self) -> tuple[Any, luxloop.Arrivals]:
        """State and arrivals before the first exposure."""
        return self.plant.start()

    def show(self, state: Any, exposure: luxloop.Exposure) -> tuple[Any, luxloop.Arrivals]:
        """Frames of the own light in the other's."""
        return self.plant.show(state, replace(exposure, lights=(*exposure.lights, *self.other)))


def prepare(side: str, *changes: str) -> luxloop.Simulation:
    """One car, alone on the road."""
    return luxloop.prepare(luxloop.load("flat", [*SCENARIO, f"headlight.lamps=['{side}']", f"camera.y_m={ASIDE_M[side]}", *changes]))


def share(car: luxloop.Simulation, other: luxloop.Simulation) -> luxloop.Simulation:
    """The car with its share of the symbol, on the road of both."""
    lights = (car.lights[0][1], other.lights[0][1])
    shared = car.with_controller(Sharing(car.symbol.controller, car.symbol.projector, lights))
    return replace(shared, plant=SharedRoad(car.plant, other.plant))


def drive(one: luxloop.Simulation, two: luxloop.Simulation, rounds: int) -> Iterator[tuple[Lights, Lights]]:
    """Light of both cars after each round, in which each measures for a control period while the other's light stays as it is."""
    cars, states, lights = (one, two), [one.start(), two.start()], [one.symbol.projector.resting, two.symbol.projector.resting]
    for _ in range(rounds):
        for k, car in enumerate(cars):
            car.plant.other = lights[1 - k]
            states[k], result = car.step(states[k])
            lights[k] = result.exposures[0].lights
        yield lights[0], lights[1]


def from_above(car: luxloop.Simulation, lights: Lights) -> Tensor:
    """Illuminance `[rows, cols]` in lx on the road around the symbol, at points 2 cm apart."""
    down = torch.tensor([[0.0, -1, 0, 16], [-1, 0, 0, 0], [0, 0, -1, 40], [0, 0, 0, 1]], dtype=torch.float64)
    seen = car.plant.road.through(View(150, 300, 2000.0, 2000.0, 75.0, 150.0, down), 0.0)
    return seen.light([each.u for each in lights])[0]


def iou(car: luxloop.Simulation, own: Lights, other: Lights) -> float:
    """IoU of both lights together with the target, as the car's camera sees them."""
    return float(replace(car.symbol.evaluator, world=car.plant.road).metrics((*own, *other), 0.0).iou)


def compare(road: str, *changes: str, rounds: int = 8) -> dict[str, float]:
    """Summed illuminance relative to that of one car which draws the whole symbol, where it is lit, and IoU as each camera sees it."""
    alone = [prepare(side, f"road={road}", *changes) for side in ASIDE_M]
    left, right = share(*alone), share(*alone[::-1])
    *_, together = drive(left, right, rounds)
    opened = next(drive(*(share(each.lit_by("open_loop"), other) for each, other in zip(alone, alone[::-1], strict=True)), 1))
    *_, last = (result for result, _ in zip(alone[0].run(), range(rounds), strict=False))
    single = from_above(left, (*last.exposures[0].lights, *alone[1].symbol.projector.resting))
    lit = single > WANTED_LX / 2
    inside = -torch.nn.functional.max_pool2d(-lit[None].float(), 7, 1, 3)[0] > 0  # 6 cm and more from the edges
    off = (from_above(left, (*together[0], *together[1])) / single - 1).abs()
    return {
        "deviation, median": float(off[lit].median()),
        "deviation, 95 % of the points": float(off[lit].quantile(0.95)),
        "deviation inside, 95 % of the points": float(off[inside].quantile(0.95)),
        "IoU, left": iou(left, *together),
        "IoU, right": iou(right, *together[::-1]),
        "IoU, left, open loop": iou(left, *opened),
        "IoU, right, open loop": iou(right, *opened[::-1]),
    }


if __name__ == "__main__":
    for name, figure in compare(sys.argv[1] if sys.argv[1:] else "{kind='bumps', seed=3}").items():
        print(f"{name}: {figure:.3f}")
