"""Feedback laws of many copies as one law over tensors with a batch dimension."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, cast

import torch
from torch import Tensor

from controllers.pid import PidGains
from controllers.pixels.ssc import Utilisation
from controllers.symbol import AnyParams
from controllers.symbol.laws.feedback import Feedback, FeedbackParams, ModelReferenceParams
from controllers.symbol.laws.lifting import Lifting
from controllers.symbol.laws.open_loop import OpenLoop
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


def law_of(controllers: Sequence[SymbolController]) -> OpenLoop | ThesisPid | Feedback:
    """The law of controllers of one shape (`shape_of`), lifted or not, with the values of each in a row `[B, ...]`."""
    laws = [each.inner if isinstance(each, Lifting) else each for each in controllers]
    first = cast(OpenLoop | ThesisPid | Feedback, laws[0])
    device = first.target.device
    if isinstance(first, ThesisPid):
        given = [cast(ThesisPid, each) for each in laws]
        names = [each.name for each in fields(PidGains) if each.name != "form"]
        gains = {name: torch.stack([getattr(each.gains, name) for each in given]) for name in names}
        losses = torch.tensor([each.losses_to_reset for each in given], device=device)
        return replace(first, gains=replace(first.gains, **gains), losses_to_reset=losses)
    if isinstance(first, Feedback):
        return replace(
            first, **{name: torch.stack([getattr(each, name) for each in laws]) for name in ("low", "high", "gain", "losses_to_reset")}
        )
    return first


def asks(law: OpenLoop | ThesisPid | Feedback) -> bool:
    """Whether a law asks what a flat road would show."""
    return isinstance(law, Feedback) and isinstance(law.params, ModelReferenceParams)


def asking(law: OpenLoop | ThesisPid | Feedback, features: Tensor | None) -> OpenLoop | ThesisPid | Feedback:
    """The law as it steps on frames of which a flat road would show these features `[B, 4]`."""
    return replace(law, sensor=Rendered(law.sensor.model, features)) if isinstance(law, Feedback) and features is not None else law


def rows(chosen: Tensor, new: Any, old: Any) -> Any:
    """The chosen rows `[B]` bool of one value of tensors `[B, ...]`, and the others of another."""
    if isinstance(new, Tensor):
        return torch.where(chosen.view(-1, *[1] * (new.dim() - 1)), new, old)
    if not is_dataclass(new) or isinstance(new, type):
        return new
    return replace(new, **{each.name: rows(chosen, getattr(new, each.name), getattr(old, each.name)) for each in fields(new)})
