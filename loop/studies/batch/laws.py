"""Feedback laws of many copies as one law over tensors with a batch dimension."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from operator import attrgetter
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.pid import PidGains
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol import AnyParams
from luxloop.controllers.symbol.feedback import Feedback, FeedbackParams, ModelReferenceParams, ThesisPid
from luxloop.controllers.symbol.sensing.flat_model import FlatModel
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import SymbolController
from luxloop.controllers.symbol.stages import Lifting, StagedParams
from luxloop.world.errors import LuxloopError

LAWS = ("open", "thesis_pid", "gauss_newton", "model_reference")


@dataclass(frozen=True)
class Rendered:
    """A sensor with features computed in advance: features `[B, 4]` that a flat road would show in the newest frames."""

    model: FlatModel
    features: Tensor

    def render(self, projection: ProjectionCommand, lights: Sequence[Utilisation]) -> Tensor:
        return self.features


def refuse_controller(params: AnyParams | None, name: str, otherwise: str = "run it one by one") -> None:
    """Raises LuxloopError for a controller that is not a law over tensors alone. name: of the scenario. otherwise: the remedy."""
    assert params is not None
    if params.name not in LAWS:
        raise LuxloopError(f"{name}: batches have no controller {params.name}, which is more than a law over tensors; {otherwise}")
    if isinstance(params, StagedParams) and (params.warp or params.supervisor):
        raise LuxloopError(f"{name}: batches have no stages; leave out controller.warp and controller.supervisor, or {otherwise}")


def shape_of(params: AnyParams | None) -> tuple[str, ...]:
    """What copies must have in common for one law over all of them."""
    assert params is not None
    return (params.name, params.dof) if isinstance(params, FeedbackParams) else (params.name,)


def law_of(controllers: Sequence[SymbolController]) -> SymbolController:
    """The law of controllers of one shape (`shape_of`), lifted or not, with the values of each in a row `[B, ...]`."""
    laws: list[Any] = [each.inner if isinstance(each, Lifting) else each for each in controllers]
    first = laws[0]

    def of_each(name: str) -> Tensor:
        return torch.stack([torch.as_tensor(attrgetter(name)(each), device=first.target.device) for each in laws])

    if isinstance(first, ThesisPid):
        gains: dict[str, Any] = {each.name: of_each(f"gains.{each.name}") for each in fields(PidGains) if each.name != "form"}
        return replace(first, gains=replace(first.gains, **gains), losses_to_reset=of_each("losses_to_reset"))
    if isinstance(first, Feedback):
        values: dict[str, Any] = {name: of_each(name) for name in ("low", "high", "gain", "losses_to_reset")}
        return replace(first, **values)
    law: SymbolController = first
    return law


def asks(law: SymbolController) -> bool:
    """Whether a law needs the features that a flat road would show."""
    return isinstance(law, Feedback) and isinstance(law.params, ModelReferenceParams)


def asking(law: SymbolController, features: Tensor | None) -> SymbolController:
    """The law for frames of which a flat road would show these features `[B, 4]`."""
    return replace(law, sensor=Rendered(law.sensor.model, features)) if isinstance(law, Feedback) and features is not None else law


def rows(chosen: Tensor, new: Any, old: Any) -> Any:
    """Rows of two values with tensors `[B, ...]`: those of `new` where chosen `[B]` is True, else those of `old`."""
    if isinstance(new, Tensor):
        return torch.where(chosen.view(-1, *[1] * (new.dim() - 1)), new, old)
    if not is_dataclass(new) or isinstance(new, type):
        return new
    return replace(new, **{each.name: rows(chosen, getattr(new, each.name), getattr(old, each.name)) for each in fields(new)})
