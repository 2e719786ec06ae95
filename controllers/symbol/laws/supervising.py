"""A stage on top of any controller: the open loop is shown where the controller's symbol lies no better, or something hides the road."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.symbol.laws.alignment import Alignment
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation, SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.params import Params


class SupervisorParams(Params):
    """When a controller is given the charge, and when it loses it."""

    grace_steps: int = Field(
        8, ge=1, le=1_000_000, description="observations of the controller's symbol, after which it has to lie better than the open loop's"
    )
    explained: float = Field(
        0.3, ge=0, le=1, description="share of the residual that registration explains at least; of obstacles it is less"
    )
    changed: float = Field(0.05, gt=0, le=1, description="change of the open loop's residual, 1 minus IoU, that is worth another try")


@dataclass(frozen=True)
class SupervisingState:
    """inner: state of the controller in charge, None for the open loop. opened: residual of the open loop when it was last seen.

    observations: at the controller's symbol so far. failed: residual of the open loop that nothing could be done about, None for none.
    """

    inner: Any = None
    opened: float = 1.0
    observations: int = 0
    failed: float | None = None


class Supervising:
    """Begins with the open loop; the controller takes over from there where the road is uneven, as long as it is better."""

    def __init__(self, params: SupervisorParams, inner: SymbolController, sensor: SymbolSensor) -> None:
        self.params, self.inner, self.target = params, inner, sensor.projector.target
        self.alignment = Alignment.prepare(sensor)
        self.flat = ProjectionCommand(self.target)

    def start(self, pose: Tensor) -> SupervisingState:
        """The open loop, whatever the pose `[4]`."""
        return SupervisingState()

    def projection(self, state: SupervisingState, ego: Ego | None) -> ProjectionCommand:
        """The open loop's, or the controller's."""
        return self.flat if state.inner is None else self.inner.projection(state.inner, ego)

    def step(self, state: SupervisingState, observation: Observation) -> SupervisingState:
        """Judge what was seen, then step the controller if it is in charge."""
        if observation.measurement.code == ExtractionStatus.NO_FRAME:
            return state if state.inner is None else replace(state, inner=self.inner.step(state.inner, observation))
        image = (
            self.alignment.image(observation.measurement)
            if observation.measurement.code == ExtractionStatus.SEEN
            else torch.zeros_like(self.alignment.target)
        )
        residual = float(self.alignment.residual(image))
        opened = observation.shown.projection.shows(self.flat)
        if state.inner is None:
            return self._tried(residual, image, state, observation) if opened else state
        if opened:
            return replace(state, opened=residual, inner=self.inner.step(state.inner, observation))
        if state.observations >= self.params.grace_steps and residual >= state.opened:
            return SupervisingState(failed=state.opened)
        return replace(state, observations=state.observations + 1, inner=self.inner.step(state.inner, observation))

    def _tried(self, residual: float, image: Tensor, state: SupervisingState, observation: Observation) -> SupervisingState:
        """The controller, unless it has failed here before or a registration explains too little, as where something hides the road."""
        if observation.measurement.code != ExtractionStatus.SEEN or (
            state.failed is not None and abs(residual - state.failed) < self.params.changed
        ):
            return state
        placement = self.alignment.register(image, "homography+mesh")
        left = float(self.alignment.residual(self.alignment.undone(image, placement)))
        if left > (1 - self.params.explained) * residual:
            return SupervisingState(failed=residual)
        return SupervisingState(self.inner.step(self.inner.start(self.target), observation), residual)
