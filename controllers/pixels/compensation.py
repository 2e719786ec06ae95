"""Compensation of worn pixels: others take over their light, within their limits."""

from typing import Final

import torch
from torch import Tensor

from luxloop.world.headlight import Headlight
from luxloop.world.spmv import multiply, solve

EVEN: Final = 0.02  # of the greatest intensity, above which errors count relative to the light
ITERATIONS: Final = 20
TEXELS: Final = 5  # across the light of a pixel, at which light is compared
DARK: Final = 0.3  # gain below which a pixel's own light is left as it is: it would hardly help


class Compensation:
    """Utilisations with which a worn module comes closest to the light of a new one. gains: `[n_p]`, light relative to new pixels."""

    def __init__(self, headlight: Headlight, gains: Tensor) -> None:
        coarse = headlight.coarsen(TEXELS)
        self._new, self._worn, self._gains = coarse.matrix, coarse.dim(gains).matrix, gains

    def utilisation(self, u: Tensor) -> Tensor:
        """Utilisation `[n_p]` in place of u `[n_p]`; pixels that are off stay off, so that masks stay dark."""
        light = multiply(self._new, u)
        start = torch.where(self._gains < DARK, u, u / self._gains.clamp(min=DARK)).clamp(max=1)
        weight = 1 / (light + EVEN * light.max().clamp(min=1e-9))
        return solve(self._worn, light, weight=weight, upper=(u > 0).to(u), start=start, iterations=ITERATIONS)
