"""What one who learns gets: observations within finite bounds, and a reward from the judge."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from controllers.symbol.sensing.symbol_sensor import Measurement
from loop.environment.acting import Acting
from perception.egomotion import Ego
from perception.extraction import Loss
from perception.judge import Verdict

Floats = npt.NDArray[np.float32]

ERRORS: Final = (20.0, 10.0, 0.5, 0.5)  # m, m, rad, rad: greatest that are told
AREA: Final = 4.0
MOTION: Final = (100.0, 3.0)  # m/s, rad/s
CENTROID_WEIGHT, ACTION_WEIGHT = 0.5, 0.01


@dataclass(frozen=True)
class Reward:
    """reward: `[...]`, the sum of the terms. terms: `[...]` each.

    iou: overlap of the symbol with its target on the road, 0..1. centroid: -0.5 times the distance of their centroids, in lengths and
    widths of the symbol, 1 at most. action: -0.01 times the mean square of the action. Where nothing is lit iou is 0 and centroid -0.5.
    """

    reward: Tensor
    terms: dict[str, Tensor]


def reward(verdict: Verdict, action: Tensor) -> Reward:
    """Of the light that an action `[..., n]` leads to."""
    away = (verdict.centroid_percent / 100).norm(dim=-1).nan_to_num(1.0).clamp(max=1.0)
    terms = {
        "iou": verdict.iou.nan_to_num(0.0),
        "centroid": -CENTROID_WEIGHT * away,
        "action": -ACTION_WEIGHT * action.square().mean(-1).to(away),
    }
    return Reward(sum(terms.values(), torch.zeros_like(away)), terms)


def bounds(acting: Acting) -> tuple[Floats, Floats]:
    """Least and greatest values of an observation, `[n]` each."""
    low, high = (each.cpu().tolist() for each in acting.limits)
    least = [*low, *(-each for each in ERRORS), *[0.0] * len(Loss), 0.0, 0.0, -MOTION[1]]
    most = [*high, *ERRORS, *[1.0] * len(Loss), AREA, *MOTION]
    return np.array(least, np.float32), np.array(most, np.float32)


def observation(told: Tensor, seen: Measurement, ego: Ego | None) -> Tensor:
    """`[..., n]`, see `SymbolEnv`. told: `[..., k]`, see `Acting`. seen: what the newest frames show."""
    usable = (seen.code == Loss.SEEN) & seen.pose_error.isfinite().all(-1)
    most = told.new_tensor(ERRORS)
    errors = torch.where(usable[..., None], seen.pose_error, 0.0).clamp(-most, most)
    codes = torch.nn.functional.one_hot(seen.code, len(Loss)).to(told)
    area = torch.where(usable, seen.area_ratio, 0.0).nan_to_num(0.0).clamp(0, AREA)
    moving = told.new_zeros(2) if ego is None or ego.stands else torch.stack([ego.speed_m_s, ego.yaw_rate_rad_s]).to(told)
    motion = moving.clamp(told.new_tensor([0.0, -MOTION[1]]), told.new_tensor(MOTION)).expand(*told.shape[:-1], 2)
    return torch.cat([told, errors, codes, area[..., None], motion], -1)


def image(seen: Measurement, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """The symbol as it was extracted, `[..., h, w]` in 0..255: the camera's image where it is looked for, scaled to a size."""
    symbol = seen.symbol
    if not symbol.numel():
        return np.zeros((*symbol.shape[:-2], *size), np.uint8)
    scaled = interpolate(symbol.reshape(-1, 1, *symbol.shape[-2:]), size, mode="bilinear", align_corners=False, antialias=True)
    return (255 * scaled).round().clamp(0, 255).byte().reshape(*symbol.shape[:-2], *size).cpu().numpy()
