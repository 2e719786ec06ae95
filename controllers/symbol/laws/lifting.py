"""A stage on top of any controller: what it draws is lifted onto the road that an acquisition found."""

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation, SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus

SURE = 0.85  # match with which a road is believed though the symbol is seen as on another; on grades it is above 0.9
LOSSES = 4  # in a row, after which a shape is given up: more than after which controllers show their target again


@dataclass(frozen=True)
class LiftingState:
    """inner: the controller's state. shape: `[4]` of the road that is drawn for, None for the plane z = 0. losses: in a row, on a shape."""

    inner: Any
    shape: Tensor | None = None
    losses: int = 0


class Lifting:
    """The controller draws and sees as on the plane z = 0, and begins anew at the target on every other road that is acquired."""

    def __init__(self, inner: SymbolController, sensor: SymbolSensor) -> None:
        self.inner, self.sensor, self.projector = inner, sensor, sensor.projector

    def start(self, pose: Tensor) -> LiftingState:
        """State that shows the pose `[..., 4]` first."""
        return LiftingState(self.inner.start(pose))

    def projection(self, state: LiftingState, ego: Ego | None) -> ProjectionCommand:
        """The controller's, for the road as it is known."""
        projection = self.inner.projection(state.inner, ego)
        return projection if state.shape is None else replace(projection, shape=state.shape)

    def step(self, state: LiftingState, observation: Observation) -> LiftingState:
        """Step the controller by what was drawn for the road as it is known; the errors of earlier light are those of another plant."""
        if not _same(observation.shown.projection.shape, state.shape):
            return state
        shape, losses = self._known(state, observation)
        if not _same(shape, state.shape):
            return LiftingState(self.inner.start(self.projector.target), shape)
        if shape is not None:
            projection = replace(observation.shown.projection, shape=None)
            observation = replace(
                observation, shown=replace(observation.shown, projection=projection, lights=self.projector.draw(projection))
            )
        return LiftingState(self.inner.step(state.inner, observation), shape, losses)

    def _known(self, state: LiftingState, observation: Observation) -> tuple[Tensor | None, int]:
        """The road's shape after an observation, None on the move, which shapes do not follow, and how often in a row the symbol was lost
        on it.
        """
        moving = observation.ego is not None and not observation.ego.stands
        if observation.measurement.code.dim() or moving:
            return None, 0
        if observation.measurement.code == ExtractionStatus.SEEN:
            return self._beyond(state.shape, observation) if observation.measurement.acquired is None else observation.measurement.shape, 0
        losses = state.losses + int(state.shape is not None and observation.measurement.code != ExtractionStatus.NO_FRAME)
        return (None, 0) if losses == LOSSES else (state.shape, losses)

    def _beyond(self, known: Tensor | None, observation: Observation) -> Tensor | None:
        """The known shape, or that of a road farther off where the symbol reaches the footprint's ends."""
        if observation.frames is None or not self.sensor.at_ends(observation.measurement):
            return known
        found = self.sensor.acquire(observation.frames, observation.shown.lights)
        risen = found.shape[0] - (0.0 if known is None else known[0])
        return found.shape if found.match > SURE and found.found and risen.abs() > self.sensor.params.footprint_margin_m else known


def _same(a: Tensor | None, b: Tensor | None) -> bool:
    return a is b or (a is not None and b is not None and a.equal(b))
