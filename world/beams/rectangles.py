"""Setpoints to evaluate controllers: rectangles of even light in five degrees of freedom (T 8.4)."""

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.texels import TexelGrid

SETPOINT_CD = 10_000.0

# The thesis gives the ranges of width, height and horizontal position; vertical positions and turns are our choice, within the field.
H_DEG = tuple(2.5 * step for step in range(-4, 5))
V_DEG = (-2.0, -1.0, 0.0, 1.0, 2.0)
WIDTHS_DEG = (1.5, 3.75, 6.0)
HEIGHTS_DEG = (1.0, 2.0, 3.0)
TURNS_DEG = (0.0, 15.0, 30.0)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in deg about (h, v), left and up positive, turned counter-clockwise as seen from the lamp."""

    h: float
    v: float
    width: float
    height: float
    turn: float = 0.0

    def distance(self, h: Tensor, v: Tensor) -> Tensor:
        """Distance of directions from the rectangle in deg, as the larger of the distances along its sides; negative inside."""
        angle = torch.deg2rad(torch.tensor(self.turn, dtype=h.dtype, device=h.device))
        x, y = h - self.h, v - self.v
        along, across = x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin()
        return torch.maximum(along.abs() - self.width / 2, across.abs() - self.height / 2)

    def texture(self, grid: TexelGrid, intensity_cd: float = SETPOINT_CD) -> Tensor:
        """The wanted light texture `[rows, cols]` in cd, float32: this intensity inside and none outside.

        Raises: LuxloopError where no texel lies inside.
        """
        y, z = grid.tangents(torch.float64, torch.device("cpu"))
        inside = self.distance(torch.rad2deg(y.atan()), torch.rad2deg(z.atan())[:, None]) <= 0
        if not inside.any():
            raise LuxloopError(f"{self} covers no texel of the light texture: place it inside of the lamp's field")
        return intensity_cd * inside.float()


RECTANGLES = [Rectangle(*values) for values in itertools.product(H_DEG, V_DEG, WIDTHS_DEG, HEIGHTS_DEG, TURNS_DEG)]

# One a position, so that each width, height and turn comes 15 times, each pair of them 5 times, and all of them in every column and row.
QUICK = [
    Rectangle(h, v, WIDTHS_DEG[(i + j) % 3], HEIGHTS_DEG[(i // 3 + j) % 3], TURNS_DEG[(i + i // 3 + j) % 3])
    for i, h in enumerate(H_DEG)
    for j, v in enumerate(V_DEG)
]
