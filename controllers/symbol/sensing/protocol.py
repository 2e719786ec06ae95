"""Protocol of symbol controllers: state in, state out, and a projection command."""

from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.perception.egomotion import Ego


@dataclass(frozen=True)
class Projection:
    """The projection of a step.

    projection: of the symbol. lights: utilisations, one a module. ego: the motion with which it was drawn, None for a standing vehicle.
    """

    projection: ProjectionCommand
    lights: tuple[Utilisation, ...]
    ego: Ego | None = None


@dataclass(frozen=True)
class Observation:
    """The controller's input in a step.

    measurement: features and errors of the symbol. frames: on and off frame `[height, width]`, digital numbers; None if lost or not yet
    arrived. shown: projection in these frames, older than this step if the camera has latency. ego: the present motion, None for a standing
    vehicle.
    """

    measurement: Measurement
    frames: tuple[Tensor, Tensor] | None
    shown: Projection
    ego: Ego | None = None


class SymbolController(Protocol):
    """Draws the symbol; its state is a frozen dataclass of tensors."""

    def start(self, pose: Tensor) -> Any:
        """State that first shows the pose `[..., 4]` (x, y in m, roll, pitch in rad)."""
        ...

    def projection(self, state: Any, ego: Ego | None) -> ProjectionCommand:
        """The next projection command. ego: the present motion, newer than any observation, or None."""
        ...

    def step(self, state: Any, observation: Observation) -> Any:
        """The state after one observation."""
        ...
