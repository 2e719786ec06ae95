"""No control: the flat-road primitive at the target, whatever the camera sees."""

from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation
from luxloop.perception.egomotion import Ego
from luxloop.world.params import Params


class OpenLoopParams(Params):
    """No control: what lies straight at the target on a flat road is shown for ever. The start pose is ignored."""

    name: Literal["open"] = "open"


@dataclass(frozen=True)
class OpenLoop:
    """Shows the target pose `[4]` for ever; the state is the pose."""

    target: Tensor

    def start(self, pose: Tensor) -> Tensor:
        """The target, in the shape of the pose `[..., 4]`."""
        return self.target.expand_as(pose)

    def projection(self, state: Tensor, ego: Ego | None) -> ProjectionCommand:
        """The symbol as it is at the target `[..., 4]`."""
        return ProjectionCommand(state)

    def step(self, state: Tensor, observation: Observation) -> Tensor:
        """Nothing changes."""
        return state
