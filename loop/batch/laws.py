"""Feedback laws of many copies as one law over tensors with a batch dimension."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from operator import attrgetter
from typing import Any

import torch
from torch import Tensor

from controllers.pid import PidGains
from controllers.pixels.ssc import Utilisation
from controllers.symbol import AnyParams
from controllers.symbol.laws.feedback import Feedback, FeedbackParams, ModelReferenceParams
from controllers.symbol.laws.lifting import Lifting
from controllers.symbol.laws.stages import StagedParams
from controllers.symbol.laws.thesis_pid import ThesisPid
from controllers.symbol.sensing.flat_model import FlatModel
from controllers.symbol.sensing.projection import ProjectionCommand
from controllers.symbol.sensing.protocol import SymbolController
from world.errors import LuxloopError

LAWS = ("open", "thesis_pid", "gauss_newton", "model_reference")


@dataclass(frozen=True)
class Rendered:
    """What a law asks its sensor, known beforehand: features `[B, 4]` of what the newest frames show, on a flat road."""

    model: FlatModel
    features: Tensor

    def rendered(self, projection: ProjectionCommand, lights: Sequence[Utilisation]) -> Tensor:
        return self.features


def refuse_controller(params: AnyParams | None, name: str, otherwise: str = "run it one by one") -> None:
    """Raises LuxloopError for a controller that is no law over tensors alone, of a scenario of this name."""
    assert params is not None
    if params.name not in LAWS:
        raise LuxloopError(f"{name}: batches have no controller {params.name}, which is more than a law over tensors; {otherwise}")
    if isinstance(params, StagedParams) and (params.warp or params.supervisor):
        raise LuxloopError(f"{name}: batches have no stages; leave out controller.warp and controller.supervisor, or {otherwise}")


def shape_of(params: AnyParams | None) -> tuple[str, ...]:
    """What copies must have in common for one law of all."""
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
    """Whether a law asks what a flat road would show."""
    return isinstance(law, Feedback) and isinstance(law.params, ModelReferenceParams)


def asking(law: SymbolController, features: Tensor | None) -> SymbolController:
    """The law as it steps on frames of which a flat road would show these features `[B, 4]`."""
    return replace(law, sensor=Rendered(law.sensor.model, features)) if isinstance(law, Feedback) and features is not None else law


def rows(chosen: Tensor, new: Any, old: Any) -> Any:
    """The chosen rows `[B]` bool of one value of tensors `[B, ...]`, and the others of another."""
    if isinstance(new, Tensor):
        return torch.where(chosen.view(-1, *[1] * (new.dim() - 1)), new, old)
    if not is_dataclass(new) or isinstance(new, type):
        return new
    return replace(new, **{each.name: rows(chosen, getattr(new, each.name), getattr(old, each.name)) for each in fields(new)})
