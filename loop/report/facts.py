"""Figures of a lamp's light: field, flux, peak."""

import math
from collections.abc import Sequence
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


def flux_lm(grid: TexelGrid, texture: Tensor) -> float:
    """Luminous flux in lm of a light texture `[rows, cols]` in cd: each texel by its solid angle."""
    return float((texture.double().cpu() * torch.from_numpy(solid_angles(grid))).sum())


def borders_deg(grid: TexelGrid) -> tuple[float, float, float, float]:
    """Left and right (left positive), bottom and top (up positive) of a texture as angles in deg from its axis."""
    left, right, bottom, top = np.degrees(np.arctan([grid.left, grid.right, grid.bottom, grid.top])).tolist()
    return left, right, bottom, top
