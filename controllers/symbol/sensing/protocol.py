"""Protocol of symbol controllers: state and observation in, state and projection command out."""

from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.perception.egomotion import Ego


@dataclass(frozen=True)
class Projection:
    """The light of a step.

    projection: command of the symbol. lights: utilisations, one a module. ego: vehicle motion for which the command was drawn, None for a
    standing vehicle.
    """

    projection: ProjectionCommand
    lights: tuple[Utilisation, ...]
    ego: Ego | None = None


@dataclass(frozen=True)
class Observation:
    """The controller's input in a step.

    measurement: features and errors of the symbol. frames: on and off frame `[height, width]`, digital numbers; None if lost or not yet
    arrived. shown: the light in these frames, older than this step if the camera has latency. ego: present vehicle motion, None for a
    standing vehicle. latency_steps: measured latency, the number of steps from the exposure of the frames to this step.
    """

    measurement: Measurement
    frames: tuple[Tensor, Tensor] | None
    shown: Projection
    ego: Ego | None = None
    latency_steps: int = 0


class SymbolController(Protocol):
    """Holds a symbol by projection commands; its state is a frozen dataclass of tensors."""

    def start(self, pose: Tensor) -> Any:
        """The initial state, whose command shows the pose `[..., 4]` (x, y in m, roll, pitch in rad)."""
        ...

    def projection(self, state: Any, ego: Ego | None) -> ProjectionCommand:
        """The next command. ego: present vehicle motion, newer than the last observation, or None."""
        ...

    def step(self, state: Any, observation: Observation) -> Any:
        """The state after one observation."""
        ...
