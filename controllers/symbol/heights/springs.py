"""How a mode of the body moves on its spring and damper, in closed form: over a road that is known, and as other things shake it."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import torch
from torch import Tensor

PARTS: Final = 8  # of a time, over which what a mode follows is linear
OTHER_HZ: Final = 1.3  # of what else shakes the body, undamped


@lru_cache(maxsize=64)
def followed(rate_hz: float, damping: float, duration_s: float) -> Tensor:
    """Value and rate `[2, 2 + PARTS + 1]` of a mode on its spring and damper after some time, exactly.

    Columns: value and rate before, and what the mode follows at even times, from beginning to end, linear in between.
    """
    omega, part_s = 2 * math.pi * rate_hz, duration_s / PARTS
    spring, damper = omega**2, 2 * damping * omega
    found = torch.eye(2, 2 + PARTS + 1, dtype=torch.float64)
    if duration_s == 0:
        return found
    step = _exponential([[0, 1, 0, 0], [-spring, -damper, spring, damper], [0, 0, 0, 1], [0, 0, 0, 0]], part_s)[:2]
    for part in range(2, 2 + PARTS):
        found = step[:, :2] @ found
        found[:, part] += step[:, 2] - step[:, 3] / part_s
        found[:, part + 1] += step[:, 3] / part_s
    return found


@lru_cache(maxsize=64)
def other(duration_s: float) -> Tensor:
    """An oscillator about a place that holds: `[3, 3]` on value, rate and acceleration."""
    return _exponential([[0, 1, 0], [0, 0, 1], [0, -((2 * math.pi * OTHER_HZ) ** 2), 0]], duration_s)


@lru_cache(maxsize=64)
def news(duration_s: float) -> Tensor:
    """Covariance `[3, 3]` of value, rate and acceleration after jerks of density 1."""
    ways = torch.stack([other((part + 0.5) * duration_s / PARTS)[:, 2] for part in range(PARTS)])
    return ways.T @ ways * (duration_s / PARTS)


def _exponential(rates: Sequence[Sequence[float]], duration_s: float) -> Tensor:
    return torch.linalg.matrix_exp(duration_s * torch.tensor(rates, dtype=torch.float64))
