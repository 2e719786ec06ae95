"""Symbol controllers by name; a scenario names one."""

from typing import Annotated

from pydantic import Field

from controllers.symbol.luxloop import Luxloop, LuxloopParams
from controllers.symbol.observer import Observer
from controllers.symbol.open_loop import OpenLoop, OpenLoopParams
from controllers.symbol.protocol import SymbolController
from controllers.symbol.thesis_pid import ThesisPid, ThesisPidParams

AnyParams = OpenLoopParams | ThesisPidParams | LuxloopParams
ControllerParams = Annotated[AnyParams, Field(discriminator="name")]
CONTROLLERS: dict[str, type[AnyParams]] = {"luxloop": LuxloopParams, "open": OpenLoopParams, "thesis_pid": ThesisPidParams}


def build_controller(params: AnyParams, observer: Observer) -> SymbolController:
    """The controller that a scenario names, for an observer with all that a controller may know: lamps, camera, flat road and target."""
    match params:
        case OpenLoopParams():
            return OpenLoop(observer.projector.target)
        case ThesisPidParams():
            return ThesisPid(params, observer.projector.target)
        case LuxloopParams():
            return Luxloop(params, observer)
