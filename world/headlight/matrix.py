"""The light of one matrix module: a sparse headlight matrix over a light texture (T 2.4, 5.2)."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.world.spmv import Csr, multiply, row_bounds, zeros
from luxloop.world.texels import TexelGrid, bilinear

LUMINANCE = (0.2126, 0.7152, 0.0722)  # of the channels of linear sRGB


@dataclass(frozen=True, kw_only=True)
class Headlight(TexelGrid):
    """Pixel luminous intensities on the plane x = 1 of the headlight frame.

    matrix: `[rows * cols, n_p]`, cd of pixel j at texel i at full utilisation. pixel_rows x pixel_cols = n_p pixels, row-major, row 0
    on top, column 0 on the left. chroma: None for one colour, else `[3, nnz]`, linear sRGB of each entry at luminance 1, so that
    `0.2126 R + 0.7152 G + 0.0722 B = 1` (chromatic edges, T 5.1).
    """

    name: str
    matrix: Csr
    pixel_rows: int
    pixel_cols: int
    chroma: Tensor | None = None

    @property
    def n_pixels(self) -> int:
        return self.pixel_rows * self.pixel_cols

    @property
    def peak_cd(self) -> float:
        """Largest luminous intensity of a texel with all pixels at full utilisation."""
        return float(self.light_texture(torch.ones(self.n_pixels).to(self.matrix.values)).max())

    def scale(self, factor: float) -> "Headlight":
        """The headlight with all intensities multiplied by a factor."""
        return self if factor == 1 else replace(self, matrix=self.matrix.with_values(self.matrix.values * factor))

    def dim(self, left: Tensor) -> "Headlight":
        """The headlight with each pixel's light scaled by a factor `[n_p]`."""
        of_entry = left.to(self.matrix.values).index_select(0, self.matrix.indices)
        return replace(self, matrix=self.matrix.with_values(self.matrix.values * of_entry))

    def coarsen(self, across: int) -> "Headlight":
        """The headlight on a coarser grid, of means over blocks of texels, with at least that many texels across the light of the middle
        pixel if it has as many; without chroma.
        """
        step = [max(each // across, 1) for each in self.pixel_extent]
        if step == [1, 1]:
            return replace(self, chroma=None)
        rows, cols = -(-self.rows // step[0]), -(-self.cols // step[1])
        block = (np.arange(self.rows) // step[0])[:, None] * cols + np.arange(self.cols) // step[1]
        means = sp.csr_array((np.full(self.n_texels, 1 / math.prod(step)), (block.ravel(), np.arange(self.n_texels))))
        bottom = self.top - rows * step[0] * (self.top - self.bottom) / self.rows
        right = self.left - cols * step[1] * (self.left - self.right) / self.cols
        matrix = Csr.from_scipy(means @ self.matrix.to_scipy(), self.matrix.values.dtype).to(self.matrix.values.device)
        return replace(self, rows=rows, cols=cols, bottom=bottom, right=right, matrix=matrix, chroma=None)

    def light_texture(self, utilisation: Tensor, band: slice | None = None) -> Tensor:
        """Luminous intensity `[..., rows, cols]` in cd of a utilisation `[..., n_p]` in 0..1: `i = A u` (T eq. 2.4.1, 3.5.1).

        band: range of pixels outside which all are dark; texel rows that it does not reach are skipped.
        """
        rows = self.rows_of(band)
        part = self.light_rows(utilisation, rows)
        if part.shape[-2] == self.rows:
            return part
        texture = zeros((*utilisation.shape[:-1], self.rows, self.cols), part.dtype, part.device)
        texture[..., rows, :] = part
        return texture

    def light_rows(self, utilisation: Tensor, rows: slice) -> Tensor:
        """Some rows `[..., n, cols]` of the light texture in cd."""
        return multiply(self.matrix.band(rows.start * self.cols, rows.stop * self.cols), utilisation).unflatten(-1, (-1, self.cols))

    def rows_of(self, band: slice | None) -> slice:
        """Texel rows that the pixels of a band can light; all rows for None."""
        return slice(0, self.rows) if band is None else _lit(self._pixels_of_rows, band)

    def cols_of(self, pixel_cols: slice) -> slice:
        """Texel columns that pixels of these columns can light."""
        return _lit(self._pixel_cols_of_cols, pixel_cols)

    @cached_property
    def pixel_flux(self) -> Tensor:
        """Luminous flux in lm of each pixel at full utilisation, `[n_p]`; proportional to power if all LEDs are equally efficient."""
        y, z = self.tangents(self.matrix.values.dtype, self.matrix.values.device)
        plane = (self.left - self.right) * (self.top - self.bottom) / self.n_texels
        solid_angle = plane / (1 + y * y + z[:, None] ** 2) ** 1.5
        flux = solid_angle.flatten().cpu().numpy() @ self.matrix.to_scipy()
        return torch.from_numpy(flux).to(self.matrix.values)

    @cached_property
    def pixel_extent(self) -> tuple[int, int]:
        """Texels, vertical and horizontal, in which the middle pixel's light exceeds a tenth of its peak."""
        only = torch.zeros(self.n_pixels).to(self.matrix.values)
        only[self.pixel_rows // 2 * self.pixel_cols + self.pixel_cols // 2] = 1
        light = self.light_texture(only)
        up, aside = (int((light > light.max() / 10).any(dim).sum()) for dim in (1, 0))
        return up, aside

    @cached_property
    def _pixels_of_rows(self) -> tuple[Tensor, Tensor]:
        """The first and the last pixel that lights each row of texels, both `[rows]`."""
        first, last = row_bounds(self.matrix, self.matrix.indices)
        return first.view(self.rows, self.cols).amin(1), last.view(self.rows, self.cols).amax(1)

    @cached_property
    def _pixel_cols_of_cols(self) -> tuple[Tensor, Tensor]:
        """The first and the last column of pixels that lights each column of texels, both `[cols]`."""
        first, last = row_bounds(self.matrix, self.matrix.indices % self.pixel_cols)
        return first.view(self.rows, self.cols).amin(0), last.view(self.rows, self.cols).amax(0)

    def colour_texture(self, utilisation: Tensor) -> Tensor:
        """Light texture in linear sRGB, `[..., 3, rows, cols]` in cd, one matrix product per channel; its luminance is `light_texture` (T
        5.1).
        """
        if self.chroma is None:
            return self.light_texture(utilisation)[..., None, :, :].expand(*utilisation.shape[:-1], 3, self.rows, self.cols)
        channels = [multiply(self.matrix.with_values(self.matrix.values * share), utilisation) for share in self.chroma]  # [..., n_t] each
        return torch.stack(channels, -2).unflatten(-1, (self.rows, self.cols))

    def intensity(self, light_texture: Tensor, directions: Tensor) -> Tensor:
        """Luminous intensity `[..., N]` in cd into directions `[3, N]` of the headlight frame; zero outside the texture (T 2.3)."""
        x = directions[0]
        row, col = self.texel_of(directions[1] / x, directions[2] / x)
        texel, weight = bilinear(self, row, col)
        return (light_texture.flatten(-2)[..., texel] * (weight * (x > 0)).to(light_texture)).sum(-2)  # bilinear, ahead only, [..., N]

    def mirror(self) -> "Headlight":
        """The mirror image of the headlight, with pixels again numbered from the left."""
        texel = np.arange(self.n_texels).reshape(self.rows, self.cols)[:, ::-1].ravel()
        pixel = np.arange(self.n_pixels).reshape(self.pixel_rows, self.pixel_cols)[:, ::-1].ravel()
        order = self.matrix.with_values(torch.arange(1, len(self.matrix.values) + 1, dtype=torch.float64)).to_scipy()[texel][:, pixel]
        order.sort_indices()
        entry = torch.from_numpy(order.data.astype(np.int64) - 1)
        indptr, indices = (torch.from_numpy(array.astype(np.int32)) for array in (order.indptr, order.indices))
        return replace(
            self,
            left=-self.right,
            right=-self.left,
            matrix=Csr(indptr, indices, self.matrix.values.cpu()[entry], self.n_pixels).to(self.matrix.values.device),
            chroma=None if self.chroma is None else self.chroma[:, entry.to(self.chroma.device)],
        )

    def to(self, device: torch.device) -> "Headlight":
        return replace(self, matrix=self.matrix.to(device), chroma=None if self.chroma is None else self.chroma.to(device))


def _lit(bounds: tuple[Tensor, Tensor], sources: slice) -> slice:
    """Range of targets whose first and last sources `[n]` overlap a range of sources."""
    first, last = bounds
    lit = torch.nonzero((first < sources.stop) & (last >= sources.start))[:, 0].tolist()
    return slice(lit[0], lit[-1] + 1) if lit else slice(0, 0)
