"""Two cars in one night: each car's frames show the light of both, and nothing else joins their loops."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from luxloop.loop.simulation.protocol import Arrivals, Exposure
from luxloop.loop.simulation.result import SimulationState, StepResult
from luxloop.loop.simulation.simulated import SimulatedPlant, UnderWay
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.simulation.world import World
from luxloop.world.frames import inverse
from luxloop.world.headlight.lamp import REST
from luxloop.world.scene.vehicle import Motion


@dataclass(frozen=True, eq=False)
class Meeting:
    """State of the plant of a car that meets another. queue: frames in transit. other: state of the other car. result: of its last step."""

    queue: UnderWay
    other: SimulationState
    result: StepResult | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MeetingPlant(SimulatedPlant):
    """The plant of a car that meets another car, whose step is part of each exposure.

    lit: the plant with the lamps of both cars. other: simulation of the other car, with an `OtherPlant`.
    """

    lit: SimulatedPlant
    other: Any

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals at 0 s."""
        queue, arrivals = self.lit.start()
        return Meeting(queue, self.other.start()), arrivals

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Step the other car in the light of an exposure, then expose the light of both."""
        other, result = self.other.step(replace(state.other, plant=(state.other.plant[0], exposure)))
        queue, arrivals = self.lit.show(state.queue, _both(exposure, result.exposures[0]))
        return Meeting(queue, other, result), arrivals


@dataclass(frozen=True, eq=False, kw_only=True)
class OtherPlant(SimulatedPlant):
    """The plant of the other car. State: frames in transit, and the first car's exposure of the step. lit: as of `MeetingPlant`."""

    lit: SimulatedPlant

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals at 0 s."""
        queue, arrivals = self.lit.start()
        return (queue, None), arrivals

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Expose the light of both."""
        queue, first = state
        queue, arrivals = self.lit.show(queue, _both(exposure, first))
        return (queue, first), arrivals


def meet(plant: SimulatedPlant, other: Any, motion: Motion) -> MeetingPlant:
    """The plant of a car at the world's origin that meets another. other: simulation of that car alone. motion: where it stands."""
    own, alone, T_own_other = plant.world, other.plant.world, motion.at(0.0).T_world_body
    world = World(own.scene, alone.modules, alone.camera, alone.source, motion, given=own.given)
    lamps = (*own.modules, *_moved(alone.modules, T_own_other)), (*alone.modules, *_moved(own.modules, inverse(T_own_other)))
    lit = World(own.scene, lamps[0], own.camera, own.source), World(own.scene, lamps[1], alone.camera, alone.source, motion)
    fields = vars(other.plant) | {"world": world}
    other = replace(other, plant=OtherPlant(**fields, lit=replace(other.plant, world=lit[1])))
    return MeetingPlant(**vars(plant), lit=replace(plant, world=lit[0]), other=other)


def _moved(modules: Sequence[LampModule], T_car_other: Tensor) -> tuple[LampModule, ...]:
    """Modules of another car, posed in this car's body frame."""
    return tuple(replace(each, T_body_headlight=T_car_other.to(each.T_body_headlight) @ each.T_body_headlight) for each in modules)


def _both(own: Exposure, other: Exposure) -> Exposure:
    """An exposure of a car with the light of another."""
    commands = [command for each in (own, other) for command in each.commands or (REST,) * len(each.lights)]
    turned = own.commands or other.commands
    return replace(own, lights=(*own.lights, *other.lights), commands=tuple(commands) if turned else ())
