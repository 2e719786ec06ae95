"""A matrix headlight: a sparse headlight matrix over a light texture with asymmetric tangents (T 2.3, 2.4, 5.1)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from world.frames import R_ISO_OPENCV, pose
from world.spmv import Csr, multiply
from world.view import View


@dataclass(frozen=True)
class Headlight:
    """Pixel luminous intensities on the plane x = 1 of the headlight frame.

    matrix: `[rows * cols, n_p]`, cd of pixel j at texel i at full utilisation. left > right and top > bottom: tangents of the
    texture's borders. pixel_rows x pixel_cols = n_p pixels, row-major, row 0 on top, column 0 on the left.
    """

    name: str
    matrix: Csr
    rows: int
    cols: int
    left: float
    right: float
    bottom: float
    top: float
    pixel_rows: int
    pixel_cols: int

    @property
    def n_pixels(self) -> int:
        return self.pixel_rows * self.pixel_cols

    def texel_of(self, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Continuous texture coordinates (row, column), texel centres at integer + 0.5, of tangents y (left) and z (up)."""
        return (self.top - z) / (self.top - self.bottom) * self.rows, (self.left - y) / (self.left - self.right) * self.cols

    def tangents(self, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
        """Tangents of the texel centres: y `[cols]` (left positive) and z `[rows]` (up positive)."""
        c = (torch.arange(self.cols, dtype=dtype, device=device) + 0.5) / self.cols
        r = (torch.arange(self.rows, dtype=dtype, device=device) + 0.5) / self.rows
        return self.left + c * (self.right - self.left), self.top + r * (self.bottom - self.top)

    def light_texture(self, utilisation: Tensor) -> Tensor:
        """Luminous intensity `[..., rows, cols]` in cd of a utilisation `[..., n_p]` in 0..1: `i = A u` (T 2.4)."""
        return multiply(self.matrix, utilisation).unflatten(-1, (self.rows, self.cols))

    def to(self, device: torch.device) -> "Headlight":
        return Headlight(**{**self.__dict__, "matrix": self.matrix.to(device)})

    def view(self, T_world_headlight: Tensor, width: int, height: int) -> View:
        """The lamp's light texture as a pinhole view of width x height px, for its shadow map."""
        fx, fy = width / (self.left - self.right), height / (self.top - self.bottom)
        T_headlight_view = pose(torch.zeros(3, dtype=torch.float64), R_ISO_OPENCV)
        return View(width, height, fx, fy, fx * self.left, fy * self.top, T_world_headlight.double().cpu() @ T_headlight_view)
