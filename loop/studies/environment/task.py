"""Observations within finite bounds, and the reward computed by the judge."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.studies.environment.acting import Acting
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError

Floats = npt.NDArray[np.float32]

ERRORS: Final = (20.0, 10.0, 0.5, 0.5)  # m, m, rad, rad: limits of observed errors
AREA: Final = 4.0
MOTION: Final = (100.0, 3.0)  # m/s, rad/s
CENTROID_WEIGHT, ACTION_WEIGHT = 0.5, 0.01


def action_of(given: Any, shape: tuple[int, ...]) -> Tensor:
    """An action `[..., n]` within -1..1. Raises LuxloopError where it has another shape, or is not finite."""
    taken = torch.as_tensor(np.asarray(given, np.float32))
    if taken.shape != shape or not bool(taken.isfinite().all()):
        raise LuxloopError(f"step: an action has the shape {shape} and finite numbers, not {tuple(taken.shape)} or NaN; see action_space")
    return taken.clamp(-1, 1)


def reward_terms(verdict: Metrics, action: Tensor) -> dict[str, Tensor]:
    """The terms `[...]` whose sum is the reward of an action `[..., n]`. verdict: of the judge on the light that follows it.

    iou: overlap of the symbol with its target on the road, 0..1. centroid: -0.5 times the distance of their centroids, relative to the
    symbol's length and width and at most 1. action: -0.01 times the mean square of the action. If nothing is lit, iou is 0 and centroid
    -0.5.
    """
    away = (verdict.centroid_percent / 100).norm(dim=-1).nan_to_num(1.0).clamp(max=1.0)
    return {
        "iou": verdict.iou.nan_to_num(0.0),
        "centroid": -CENTROID_WEIGHT * away,
        "action": -ACTION_WEIGHT * action.square().mean(-1).to(away),
    }


def bounds(acting: Acting) -> tuple[Floats, Floats]:
    """Smallest and largest values of an observation, `[n]` each."""
    low, high = (each.cpu().tolist() for each in acting.limits)
    least = [*low, *(-each for each in ERRORS), *[0.0] * len(ExtractionStatus), 0.0, 0.0, -MOTION[1]]
    most = [*high, *ERRORS, *[1.0] * len(ExtractionStatus), AREA, *MOTION]
    return np.array(least, np.float32), np.array(most, np.float32)


@dataclass(frozen=True)
class Look:
    """The observed part of a measurement of the newest frames.

    code: `[...]` int64, an `ExtractionStatus`. pose_error: `[..., 4]` m, m, rad, rad, 0 if the symbol is lost. area_ratio: `[...]`,
    measured over expected. image: `[..., h, w]` uint8, the extracted symbol, scaled; None if observations have no image.
    """

    code: Tensor
    pose_error: Tensor
    area_ratio: Tensor
    image: Tensor | None

    @classmethod
    def of(cls, seen: Measurement, size: tuple[int, int] | None) -> "Look":
        """The observed part of `seen`. size: rows and columns of the image, None for no image."""
        usable = (seen.code == ExtractionStatus.SEEN) & seen.pose_error.isfinite().all(-1)
        most = seen.pose_error.new_tensor(ERRORS)
        errors = torch.where(usable[..., None], seen.pose_error, 0.0).clamp(-most, most)
        area = torch.where(usable, seen.area_ratio, 0.0).nan_to_num(0.0).clamp(0, AREA)
        return cls(seen.code, errors, area, None if size is None else _scale(seen.symbol, size))


def observation(state: Tensor, look: Look, ego: Ego | None) -> Tensor:
    """Observation `[..., n]`, see `SymbolEnv`. state: `[..., k]`, observed part of an `Acting`'s state. ego: None for a standing car."""
    codes = torch.nn.functional.one_hot(look.code, len(ExtractionStatus)).to(state)
    moving = state.new_zeros(2) if ego is None or ego.stands else torch.stack([ego.speed_m_s, ego.yaw_rate_rad_s]).to(state)
    motion = moving.clamp(state.new_tensor([0.0, -MOTION[1]]), state.new_tensor(MOTION)).expand(*state.shape[:-1], 2)
    return torch.cat([state, look.pose_error, codes, look.area_ratio[..., None], motion], -1)


def as_gymnasium(vector: Tensor, look: Look) -> Any:
    """An observation as NumPy arrays for Gymnasium: the vector, or a dictionary of state and image."""
    state = vector.float().cpu().numpy()
    return state if look.image is None else {"state": state, "image": look.image.cpu().numpy()}


def _scale(symbol: Tensor, size: tuple[int, int]) -> Tensor:
    """A symbol image `[..., h, w]` in 0..1 as `[..., *size]` uint8."""
    if not symbol.numel():
        return torch.zeros((*symbol.shape[:-2], *size), dtype=torch.uint8, device=symbol.device)
    scaled = interpolate(symbol.reshape(-1, 1, *symbol.shape[-2:]), size, mode="bilinear", align_corners=False, antialias=True)
    return (255 * scaled).round().clamp(0, 255).byte().reshape(*symbol.shape[:-2], *size)
