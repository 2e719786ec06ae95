"""Symbol controllers by name; a scenario names one."""

from typing import Annotated, get_args

from luxloop.controllers.symbol.feedback import Feedback, GaussNewtonParams, ModelReferenceParams, ThesisPid, ThesisPidParams
from luxloop.controllers.symbol.heights.feedforward import Feedforward, FeedforwardParams, MeasuringFeedforward, OpenLoop, OpenLoopParams
from luxloop.controllers.symbol.heights.height_controller import HeightController, HeightControllerParams
from luxloop.controllers.symbol.sensing.projector import StartParams
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolController, SymbolSensor
from luxloop.controllers.symbol.stages import OwnParams, StagedParams, own_controller, with_stages
from luxloop.world.plugin import KnownOrOwn

NamedParams = HeightControllerParams | OpenLoopParams | FeedforwardParams | ThesisPidParams | GaussNewtonParams | ModelReferenceParams
AnyParams = NamedParams | OwnParams
ControllerParams = Annotated[AnyParams, KnownOrOwn("name")]
CONTROLLERS: dict[str, type[NamedParams]] = {params.model_fields["name"].default: params for params in get_args(NamedParams)}


def build_controller(params: AnyParams, sensor: SymbolSensor) -> SymbolController:
    """Build the controller of a scenario's symbol.

    params: its keys. sensor: all that a controller may know: lamps, camera, flat road and target.
    Raises LuxloopError where a user-defined controller cannot be made.
    """
    match params:
        case OpenLoopParams():
            return OpenLoop(sensor.projector.target)
        case FeedforwardParams():
            return MeasuringFeedforward(params, sensor) if params.survey else Feedforward(params, sensor)
        case ThesisPidParams():
            return with_stages(params, ThesisPid.prepare(params, sensor.projector.target), sensor)
        case HeightControllerParams():
            return HeightController(params, sensor)
        case OwnParams():
            return with_stages(params, own_controller(params, sensor), sensor)
        case GaussNewtonParams() | ModelReferenceParams():
            return with_stages(params, Feedback.prepare(params, sensor), sensor)


def refuse_target(params: AnyParams, target: str, observed: bool) -> None:
    """Raises ValueError where a controller cannot reach its symbol's kind of target. observed: whether the symbol has an observer."""
    own = isinstance(params, OwnParams) and params.warp is None and params.supervisor is None
    if observed and isinstance(params, StagedParams):
        raise ValueError(
            f"observer: {params.name} compares with what the car's camera sees of a flat road and cannot draw for another eye; "
            'set controller.name = "luxloop", or leave out the controller'
        )
    if target == "place" and isinstance(params, StagedParams) and not own:
        raise ValueError(
            f"target: {params.name} compares with the appearance on a flat road and cannot hold a place; "
            'set controller.name = "luxloop", or target = "appearance"'
        )


def refuse_start(params: AnyParams, start: StartParams) -> None:
    """Raises ValueError where a controller's limits, `x_range_m` of `x_m` and so on, do not hold its start."""
    for key, value in start:
        limits = "_range_".join(key.rsplit("_", 1))
        low, high = getattr(params, limits, (-float("inf"), float("inf")))
        if low >= high:
            raise ValueError(f"controller.{limits}: {low:g} must be less than {high:g}; give the smaller limit first")
        if not low <= value <= high:
            raise ValueError(f"start.{key}: {value:g} lies outside of controller.{limits} = [{low:g}, {high:g}]; move it or widen that")
