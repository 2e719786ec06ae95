"""Figures of a lamp's light: field, flux, peak."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from luxloop.world.headlight.lamp import Lamp, direction
from luxloop.world.photometry.texture import solid_angles
from luxloop.world.texels import TexelGrid

STEP_DEG = 0.1  # of the search for a beam's peak
EVEN_SHARE, EVEN_PART = 0.995, 0.02  # a beam is even if more than 2 % of all directions have 99.5 % of its peak
MARGIN_DEG = 0.5  # of the search beyond the field
FAINTEST = 1 / 500  # of the peak, the faintest light that counts as lit


class Peak(NamedTuple):
    """Largest luminous intensity and its direction: h to the right, v up. even: whether the beam is too even for a direction."""

    candela: float
    h_deg: float
    v_deg: float
    even: bool


def peak(lamp: Lamp, utilisations: Sequence[Tensor]) -> Peak:
    """Peak of a lamp's modules together in the far field, on a grid of `STEP_DEG`."""
    left, right, bottom, top = lamp.field_deg
    h, v = torch.meshgrid(_around(-left, -right), _around(bottom, top), indexing="ij")
    candela = lamp.intensity(utilisations, direction(h, v).flatten(1))
    at = int(candela.argmax())
    even = float((candela >= EVEN_SHARE * candela[at]).double().mean()) > EVEN_PART
    return Peak(float(candela[at]), float(h.flatten()[at]), float(v.flatten()[at]), even)


def _around(low_deg: float, high_deg: float) -> Tensor:
    """Multiples of `STEP_DEG` over a range of angles in deg and its margins."""
    first, last = math.floor((low_deg - MARGIN_DEG) / STEP_DEG), math.ceil((high_deg + MARGIN_DEG) / STEP_DEG)
    return torch.arange(first, last + 1, dtype=torch.float64) * STEP_DEG


def lit_deg(intensity: Callable[[Tensor, Tensor], Tensor]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of h and v in deg, to the right and up, of a rectangle around a beam within ±60 x ±25 deg.

    intensity: cd of `[H, W]` angles in deg.
    """
    h, v = torch.arange(-60.0, 60.5, 0.5), torch.arange(-25.0, 25.25, 0.25)
    light = intensity(*torch.meshgrid(h, v, indexing="xy"))
    lit = light > light.max() * FAINTEST
    columns, rows = h[lit.any(0)].tolist(), v[lit.any(1)].tolist()
    if not columns:
        return (-10.0, 10.0), (-4.0, 2.0)
    return (min(columns[0] - 1.0, -5.0), max(columns[-1] + 1.0, 5.0)), (min(rows[0] - 0.5, -2.0), max(rows[-1] + 0.5, 1.5))


def flux_lm(grid: TexelGrid, texture: Tensor) -> float:
    """Luminous flux in lm of a light texture `[rows, cols]` in cd: each texel by its solid angle."""
    return float((texture.double().cpu() * torch.from_numpy(solid_angles(grid))).sum())


def borders_deg(grid: TexelGrid) -> tuple[float, float, float, float]:
    """Left and right (left positive), bottom and top (up positive) of a texture as angles in deg from its axis."""
    left, right, bottom, top = np.degrees(np.arctan([grid.left, grid.right, grid.bottom, grid.top])).tolist()
    return left, right, bottom, top
