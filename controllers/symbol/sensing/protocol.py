"""What every symbol controller is: state in, state out, and a projection of the symbol to be shown."""

from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.perception.egomotion import Ego


@dataclass(frozen=True)
class Projection:
    """What was shown in a step.

    projection: of the symbol. lights: utilisations, one a module. ego: the motion with which it was drawn, None for a vehicle that stands.
    """

    projection: ProjectionCommand
    lights: tuple[Utilisation, ...]
    ego: Ego | None = None


@dataclass(frozen=True)
class Observation:
    """What arrives in a step.

    measurement: features and errors of the symbol. frames: on and off frame `[height, width]`, digital numbers; None where the camera lost
    them or none have come. shown: what these frames show, which is older than this step where the camera is late. ego: what is known of the
    motion now, None for a vehicle that stands.
    """

    measurement: Measurement
    frames: tuple[Tensor, Tensor] | None
    shown: Projection
    ego: Ego | None = None


class SymbolController(Protocol):
    """Draws the symbol; its state is a frozen dataclass of tensors."""

    def start(self, pose: Tensor) -> Any:
        """State that shows the pose `[..., 4]` (x, y in m, roll, pitch in rad) first."""
        ...

    def projection(self, state: Any, ego: Ego | None) -> ProjectionCommand:
        """What is to be shown now. ego: what is known of the vehicle's motion now, if anything, newer than any observation."""
        ...

    def step(self, state: Any, observation: Observation) -> Any:
        """The state after one observation."""
        ...
