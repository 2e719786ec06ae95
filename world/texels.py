"""The grid of a light texture (texels on the plane x = 1 of the headlight frame, T 2.3, 5.1, 7.3.1); windows and samples of images."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import T_ISO_OPENCV, View

CPU = torch.device("cpu")
LARGEST_ANGLE_DEG = 80.0  # beyond it the plane x = 1 wastes its texels


@dataclass(frozen=True)
class Window:
    """A rectangle of a camera image or a light texture.

    v_start, v_stop: first row and the row after the last. u_start, u_stop: first column and the column after the last.
    """

    v_start: int
    v_stop: int
    u_start: int
    u_stop: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices of the image's last two dimensions."""
        return slice(self.v_start, self.v_stop), slice(self.u_start, self.u_stop)

    @property
    def empty(self) -> bool:
        return self.v_stop <= self.v_start or self.u_stop <= self.u_start

    def meets(self, other: "Window") -> bool:
        """Whether both windows share a pixel."""
        rows = self.v_start < other.v_stop and other.v_start < self.v_stop
        return rows and self.u_start < other.u_stop and other.u_start < self.u_stop

    def holds(self, other: "Window") -> bool:
        """Whether another window lies within this one."""
        rows = self.v_start <= other.v_start and other.v_stop <= self.v_stop
        return rows and self.u_start <= other.u_start and other.u_stop <= self.u_stop

    def widen(self, margin: int, height: int, width: int) -> "Window":
        """The window with a margin in pixels on all sides, clipped to an image of height x width."""
        rows = max(self.v_start - margin, 0), min(self.v_stop + margin, height)
        return Window(*rows, max(self.u_start - margin, 0), min(self.u_stop + margin, width))

    def within(self, outer: "Window") -> tuple[slice, slice]:
        """Row and column slices of this window in an image of an outer window."""
        rows = slice(self.v_start - outer.v_start, self.v_stop - outer.v_start)
        return rows, slice(self.u_start - outer.u_start, self.u_stop - outer.u_start)


NOWHERE = Window(0, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class TexelGrid:
    """rows x cols texels, row 0 on top, column 0 on the left. left > right and top > bottom: tangents of the texture's borders."""

    rows: int
    cols: int
    left: float
    right: float
    bottom: float
    top: float

    @classmethod
    def from_degrees(cls, rows: int, cols: int, left_deg: float, right_deg: float, bottom_deg: float, top_deg: float) -> "TexelGrid":
        """A grid with borders given as angles from the beam axis, left and up positive.

        Raises: LuxloopError where the borders are in the wrong order or more than 80 degrees from the axis.
        """
        angles = (left_deg, right_deg, bottom_deg, top_deg)
        if max(map(abs, angles)) > LARGEST_ANGLE_DEG:
            raise LuxloopError(f"texture borders {angles} deg: a light texture is a plane, keep it within {LARGEST_ANGLE_DEG:g} deg")
        if left_deg <= right_deg or top_deg <= bottom_deg:
            raise LuxloopError(
                f"texture borders {angles} deg: left must exceed right and top must exceed bottom, left and up being positive"
            )
        left, right, bottom, top = (math.tan(math.radians(angle)) for angle in angles)
        return cls(rows=rows, cols=cols, left=left, right=right, bottom=bottom, top=top)

    @property
    def n_texels(self) -> int:
        return self.rows * self.cols

    def texel_of(self, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Continuous texture coordinates (row, column), texel centres at integer + 0.5, of tangents y (left) and z (up) (T eq. 2.3.2)."""
        return (self.top - z) / (self.top - self.bottom) * self.rows, (self.left - y) / (self.left - self.right) * self.cols

    @property
    def borders_deg(self) -> tuple[float, ...]:
        """Left, right, bottom and top border as angles from the beam axis."""
        return tuple(math.degrees(math.atan(each)) for each in (self.left, self.right, self.bottom, self.top))

    @property
    def projection(self) -> Tensor:
        """Matrix `[3, 3]` float64 from a point of the lamp's frame to homogeneous texture coordinates w, u, v.

        u / w and v / w are -1..1 from border to border, right and down (T eq. 2.3.2).
        """
        u, v = (
            ((first + last) / (first - last), -2 / (first - last)) for first, last in ((self.left, self.right), (self.top, self.bottom))
        )
        return torch.tensor([[1, 0, 0], [u[0], u[1], 0], [v[0], 0, v[1]]], dtype=torch.float64)

    def tangents(self, dtype: torch.dtype = torch.float64, device: torch.device = CPU) -> tuple[Tensor, Tensor]:
        """Tangents of the texel centres: y `[cols]` (left positive) and z `[rows]` (up positive); rays are [1, y, z] (T eq. 7.3.1)."""
        return _centres(self.cols, self.left, self.right, dtype, device), _centres(self.rows, self.top, self.bottom, dtype, device)

    def view(self, T_world_headlight: Tensor, width: int, height: int) -> View:
        """The light texture as a pinhole view of width x height px, for a shadow map."""
        fx, fy = width / (self.left - self.right), height / (self.top - self.bottom)
        return View(width, height, fx, fy, fx * self.left, fy * self.top, T_world_headlight.double().cpu() @ T_ISO_OPENCV)


@lru_cache(64)  # used in every step
def _centres(n: int, first: float, last: float, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Tangents `[n]` in the middle of n texels between two borders."""
    return first + (torch.arange(n, dtype=dtype, device=device) + 0.5) / n * (last - first)


def bilinear(grid: TexelGrid, row: Tensor, col: Tensor) -> tuple[Tensor, Tensor]:
    """The four texels around continuous texture coordinates `[N]`: flat indices `[4, N]` int64 and weights `[4, N]`.

    Clamped within the outer half texel and, outside of the border, zero.
    """
    inside = ((row >= 0) & (row <= grid.rows) & (col >= 0) & (col <= grid.cols)).to(row)
    texel, weight = neighbours(row.nan_to_num(), col.nan_to_num(), grid.rows, grid.cols)
    return texel, weight * inside


def neighbours(row: Tensor, col: Tensor, rows: int, cols: int) -> tuple[Tensor, Tensor]:
    """The four cells of a grid around continuous coordinates `[...]`, cell centres at integer + 0.5: flat indices `[4, ...]` int64 and
    bilinear weights `[4, ...]`, clamped within the outer half cell and beyond.
    """
    r, c = (row - 0.5).clamp(0, rows - 1), (col - 0.5).clamp(0, cols - 1)
    r0, c0 = r.floor().clamp(max=max(rows - 2, 0)), c.floor().clamp(max=max(cols - 2, 0))
    fr, fc = r - r0, c - c0
    r0, c0 = r0.long(), c0.long()
    r1, c1 = (r0 + 1).clamp(max=rows - 1), (c0 + 1).clamp(max=cols - 1)
    cell = torch.stack([r0 * cols + c0, r0 * cols + c1, r1 * cols + c0, r1 * cols + c1])
    return cell, torch.stack([(1 - fr) * (1 - fc), (1 - fr) * fc, fr * (1 - fc), fr * fc])


def resample(image: Tensor, u: Tensor, v: Tensor, beyond: Literal["zeros", "border"] = "zeros", corners: bool = False) -> Tensor:
    """Sample an image `[B, channels, H, W]` at u, v `[B or 1, h, w]`, -1 to 1 over its width and height: `[B, channels, h, w]`.

    beyond: padding beyond its borders. corners: -1 and 1 are the centres of the outer pixels instead of their edges.
    """
    places = torch.stack([u, v], -1).expand(len(image), -1, -1, -1)  # [B, h, w, 2]
    return grid_sample(image, places, mode="bilinear", padding_mode=beyond, align_corners=corners)
