"""Symbol controllers by name; a scenario names one."""

from typing import Annotated

from pydantic import Tag

from controllers.symbol.heights.feedforward import Feedforward, FeedforwardParams, Surveyed
from controllers.symbol.heights.luxloop import Luxloop, LuxloopParams
from controllers.symbol.laws.feedback import Feedback, GaussNewtonParams, ModelReferenceParams
from controllers.symbol.laws.open_loop import OpenLoop, OpenLoopParams
from controllers.symbol.laws.own import OwnParams, own_controller
from controllers.symbol.laws.stages import staged
from controllers.symbol.laws.thesis_pid import ThesisPid, ThesisPidParams
from controllers.symbol.sensing.observer import Observer
from controllers.symbol.sensing.protocol import SymbolController
from world.plugin import OWN, known_or_own

NamedParams = LuxloopParams | OpenLoopParams | FeedforwardParams | ThesisPidParams | GaussNewtonParams | ModelReferenceParams
AnyParams = NamedParams | OwnParams
ControllerParams = Annotated[
    Annotated[LuxloopParams, Tag("luxloop")]
    | Annotated[OpenLoopParams, Tag("open")]
    | Annotated[FeedforwardParams, Tag("feedforward")]
    | Annotated[ThesisPidParams, Tag("thesis_pid")]
    | Annotated[GaussNewtonParams, Tag("gauss_newton")]
    | Annotated[ModelReferenceParams, Tag("model_reference")]
    | Annotated[OwnParams, Tag(OWN)],
    known_or_own("name"),
]
CONTROLLERS: dict[str, type[NamedParams]] = {
    "luxloop": LuxloopParams,
    "open": OpenLoopParams,
    "feedforward": FeedforwardParams,
    "thesis_pid": ThesisPidParams,
    "gauss_newton": GaussNewtonParams,
    "model_reference": ModelReferenceParams,
}


def build_controller(params: AnyParams, observer: Observer) -> SymbolController:
    """The controller of these params, `[controller]` of a scenario, for an observer with all that a controller may know: lamps, camera,
    flat road and target.

    Raises LuxloopError where a controller of the user's own cannot be made.
    """
    match params:
        case OpenLoopParams():
            return OpenLoop(observer.projector.target)
        case FeedforwardParams():
            return Surveyed(params, observer) if params.survey else Feedforward(params, observer)
        case ThesisPidParams():
            return staged(params, ThesisPid.prepare(params, observer.projector.target), observer)
        case LuxloopParams():
            return Luxloop(params, observer)
        case OwnParams():
            return staged(params, own_controller(params, observer), observer)
        case GaussNewtonParams() | ModelReferenceParams():
            return staged(params, Feedback(params, observer), observer)
