"""Symbol controllers by name; a scenario names one."""

from typing import Annotated

from pydantic import Field
from torch import Tensor

from controllers.symbol.open_loop import OpenLoop, OpenLoopParams
from controllers.symbol.protocol import SymbolController
from controllers.symbol.thesis_pid import ThesisPid, ThesisPidParams

ControllerParams = Annotated[OpenLoopParams | ThesisPidParams, Field(discriminator="name")]
CONTROLLERS: dict[str, type[OpenLoopParams] | type[ThesisPidParams]] = {"open": OpenLoopParams, "thesis_pid": ThesisPidParams}


def build_controller(params: OpenLoopParams | ThesisPidParams, target: Tensor) -> SymbolController:
    """The controller that a scenario names, for a flat-road target pose `[4]` (x, y in m, roll, pitch in rad)."""
    return OpenLoop(target) if isinstance(params, OpenLoopParams) else ThesisPid(params, target)
