"""The stages on top of any controller with feedback: a warp and a supervisor, if asked for, and lifting onto the road that is known."""

from pydantic import Field

from luxloop.controllers.symbol.laws.lifting import Lifting
from luxloop.controllers.symbol.laws.supervising import Supervising, SupervisorParams
from luxloop.controllers.symbol.laws.warping import Warping, WarpParams
from luxloop.controllers.symbol.sensing.protocol import SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.world.params import Params


class StagedParams(Params):
    """Keys of every controller that can have stages."""

    warp: WarpParams | None = Field(None, description="warps the symbol where the controller can do no more; left out: none")
    supervisor: SupervisorParams | None = Field(None, description="shows the open loop where control does not better it; left out: none")


def staged(params: StagedParams, controller: SymbolController, sensor: SymbolSensor) -> SymbolController:
    """The controller with the stages that its keys ask for, lifted onto the road."""
    if params.warp is not None:
        controller = Warping(params.warp, controller, sensor)
    if params.supervisor is not None:
        controller = Supervising(params.supervisor, controller, sensor)
    return Lifting(controller, sensor)
