"""Pixel-major tables of a headlight for MRPC, independent of setpoints (T 7.4), and the texels that a pixel samples (T 3.2, 3.5.1, 8.5)."""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.sparse as sp
import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.headlight import Headlight
from luxloop.world.params import Params, Share, in_order
from luxloop.world.spmv import Csr, row_of_entries, segment_bounds
from luxloop.world.texels import TexelGrid

Sampling = Literal["all", "brightest", "centroid", "uniform", "rotated", "n_rooks", "quincunx"]

EXTENT = 0.5  # a pixel's rectangle bounds its texels of at least this share of its maximum
FAINT = 1e-3  # share of the pixel's maximum given to texels of its rectangle that the real pixel does not light

# Sample positions within a pixel's rectangle, along columns and rows in 0..1, and weights.
_TILT = np.arctan(0.5)
_PATTERNS: dict[str, list[tuple[float, float, float]]] = {
    "uniform": [(c, r, 1.0) for r in (0.25, 0.75) for c in (0.25, 0.75)],
    "rotated": [(0.5 + 0.395 * np.cos(_TILT + k * np.pi / 2), 0.5 + 0.395 * np.sin(_TILT + k * np.pi / 2), 1.0) for k in range(4)],
    "n_rooks": [(0.125, 0.625, 1.0), (0.375, 0.125, 1.0), (0.625, 0.875, 1.0), (0.875, 0.375, 1.0)],
    "quincunx": [(0.5, 0.5, 0.5), *((c, r, 0.125) for r in (0.0, 1.0) for c in (0.0, 1.0))],
}


def sample_weights(entries: Csr, grid: TexelGrid, sampling: Sampling) -> Tensor:
    """Sampling weight `[nnz]` of each entry of a pixel-major headlight matrix `[n_p, n_t]`: how much its texel counts for its pixel.

    brightest, centroid: one sample per pixel; of several brightest texels, the one nearest to their centre. uniform, rotated, n_rooks: four
    samples in the pixel's rectangle. quincunx: its centre with 1/2 and its corners, which neighbours share, with 1/8. A sample falls on the
    nearest texel that the pixel reaches.
    """
    values = entries.values.double()
    if sampling == "all":
        return torch.ones_like(entries.values)
    pixel = row_of_entries(entries)
    row, col = _places(entries, grid)
    peak = _of_pixels(values, pixel, entries.n_rows, "amax")[pixel]
    if sampling in ("brightest", "centroid"):
        mass = values if sampling == "centroid" else (values == peak).double()
        total = _of_pixels(mass, pixel, entries.n_rows, "sum")[pixel]
        middle = [_of_pixels(mass * at, pixel, entries.n_rows, "sum")[pixel] / total for at in (row, col)]  # sum m_i x_i / sum m_i, [nnz]
        away = (row - middle[0]) ** 2 + (col - middle[1]) ** 2
        return _nearest_entry(torch.where(mass > 0, away, torch.inf), pixel, entries.n_rows).to(entries.values)
    within = values >= EXTENT * peak
    low, high = [], []
    for at in (row, col):
        low.append(_of_pixels(torch.where(within, at, torch.inf), pixel, entries.n_rows, "amin")[pixel] - 0.5)
        high.append(_of_pixels(torch.where(within, at, -torch.inf), pixel, entries.n_rows, "amax")[pixel] + 0.5)
    weight = torch.zeros_like(values)
    for across, down, share in _PATTERNS[sampling]:
        r, c = low[0] + down * (high[0] - low[0]), low[1] + across * (high[1] - low[1])
        weight += share * _nearest_entry((row - r) ** 2 + (col - c) ** 2, pixel, entries.n_rows)  # w_ij += share of the sample, [nnz]
    return weight.to(entries.values)


def rectangular(entries: Csr, grid: TexelGrid, threshold: float) -> Csr:
    """Pixels `[n_p, n_t]` simplified to bounding rectangles of their texels of at least `threshold` times their maximum (T 3.5.1, 8.5).

    Inside, texels that the pixel does not reach get a little light, taken from the others; outside, the pixel has none.
    """
    matrix = entries.to_scipy().tocsr()
    rows, cols, data = [], [], []
    for j in range(entries.n_rows):
        mine = slice(matrix.indptr[j], matrix.indptr[j + 1])
        texel, value = matrix.indices[mine], matrix.data[mine].astype(np.float64)
        if not len(texel):
            continue
        r, c = np.divmod(texel[value >= threshold * value.max()], grid.cols)
        box = np.zeros((r.max() - r.min() + 1, c.max() - c.min() + 1))
        at_r, at_c = texel // grid.cols - r.min(), texel % grid.cols - c.min()
        inside = (at_r >= 0) & (at_r < box.shape[0]) & (at_c >= 0) & (at_c < box.shape[1])
        box[at_r[inside], at_c[inside]] = value[inside]
        total = box.sum()
        box[box == 0] = FAINT * value.max()
        box *= total / box.sum()
        r_box, c_box = np.indices(box.shape)
        rows.append(np.full(box.size, j))
        cols.append(((r_box + r.min()) * grid.cols + c_box + c.min()).ravel())
        data.append(box.ravel())
    shape = (entries.n_rows, entries.n_cols)
    coo = sp.coo_array((np.concatenate(data), (np.concatenate(rows), np.concatenate(cols))), shape) if rows else sp.coo_array(shape)
    return Csr.from_scipy(coo.tocsr(), entries.values.dtype).to(entries.values.device)


def pixel_spread(entries: Csr, grid: TexelGrid) -> tuple[float, float]:
    """Standard deviation of a typical pixel's light in texels, along rows and columns: the median over the pixels."""
    pixel, values = row_of_entries(entries), entries.values.double()
    total = _of_pixels(values, pixel, entries.n_rows, "sum")
    spread = []
    for at in _places(entries, grid):
        mean = _of_pixels(values * at, pixel, entries.n_rows, "sum") / total
        variance = _of_pixels(values * (at - mean[pixel]) ** 2, pixel, entries.n_rows, "sum") / total
        spread.append(float(variance[total > 0].median().sqrt()) if bool((total > 0).any()) else 0.0)
    return spread[0], spread[1]


def _places(entries: Csr, grid: TexelGrid) -> tuple[Tensor, Tensor]:
    """Row and column of every entry's texel."""
    texel = entries.indices.long()
    return (texel // grid.cols).double(), (texel % grid.cols).double()


def _of_pixels(values: Tensor, pixel: Tensor, n_pixels: int, reduction: str) -> Tensor:
    """Sum, least or greatest of the values of each pixel's entries, `[n_p]`."""
    return values.new_zeros(n_pixels).scatter_reduce(0, pixel, values, reduction, include_self=False)


def _nearest_entry(away: Tensor, pixel: Tensor, n_pixels: int) -> Tensor:
    """1 for the first of each pixel's entries at the least distance, else 0: `[nnz]` float64."""
    least = away <= _of_pixels(away, pixel, n_pixels, "amin")[pixel]
    place = torch.arange(len(away), device=away.device)
    first = place.new_full((n_pixels,), len(away)).scatter_reduce(0, pixel, torch.where(least, place, len(away)), "amin")
    return (place == first[pixel]).double()


class MrpcParams(Params):
    """MapReduce pixel control: mapping, exclusion and reduction (T 7.4, 7.5.2, 8.5)."""

    a_m: float = Field(
        1.0, ge=0, le=8, description="mapping: 0 shares a setpoint equally among its pixels, 1 in proportion to their intensities"
    )
    a_r: float = Field(
        1.0, ge=0, le=8, description="reduction: 0 averages utilisations, 1 conserves light, 2 is the least-squares solution"
    )
    a_x: Share = Field(0.0, description="exclusion: texels below this share of a pixel's maximum are ignored; 0: none")
    exclusion: Literal["capability", "printed"] = Field(
        "capability", description="a_x applies to a pixel's intensity at a texel (capability), or to the setpoint as printed in T eq. 7.4.3"
    )
    a_ac: Share = Field(0.0, description="activation threshold: a pixel with a smaller share of lit setpoints is off")
    a_d: float | None = Field(
        None, gt=0, le=1e6, description="edge darkening: dims setpoints where the lamp gives less than a_d times its mean intensity"
    )
    lower_cd: float = Field(0.0, ge=0, le=1e9, description="lower bound of a pixel's setpoint at texels that a primitive covers")
    upper_cd: float | None = Field(None, gt=0, le=1e9, description="upper bound of a pixel's setpoint at texels that a primitive covers")
    mapping: Literal["potentiated", "direct", "maximal"] = Field(
        "potentiated",
        description="potentiated: by a_m and granularity; direct: the whole setpoint to each pixel; maximal: relative to the strongest",
    )
    shape: Literal["arbitrary", "rectangle"] = Field(
        "arbitrary", description="pixel shapes: unchanged, or simplified to the rectangles around their texels above a_x (0.5 if a_x is 0)"
    )
    sampling: Sampling = Field("all", description="texels that a pixel samples: all, one, or a supersampling pattern")
    granularity: float = Field(0.0, ge=0, le=4, description="mapping: exponent by which smaller pixels get larger shares")
    sharpening: float = Field(0.0, ge=0, le=4, description="strength by which setpoints beside dark ones are raised to compensate blur")
    corrections: int = Field(0, ge=0, le=10, description="number of corrections of the setpoints by the error of the resulting light")

    _bounds_in_order = in_order("lower_cd", "upper_cd", strict=False)


LEAST = 1e-16  # of a pixel's greatest I_m^a_r: least weight that sums can resolve, since a mask must act on any light


@dataclass(frozen=True, eq=False)
class PixelMajor:
    """Tables of a headlight for parameters of MRPC, pixel-major, each computed on first use."""

    grid: Headlight
    params: MrpcParams

    @cached_property
    def entries(self) -> Csr:
        """I_m,ij `[n_p, n_t]` in cd."""
        entries, params = self.grid.matrix.transpose, self.params
        return rectangular(entries, self.grid, params.a_x or 0.5) if params.shape == "rectangle" else entries

    @cached_property
    def ones(self) -> Csr:
        """The pattern of the entries."""
        return self.entries.with_values(torch.ones_like(self.entries.values))

    @cached_property
    def peak(self) -> Tensor:
        """I_m,j `[n_p]`, the greatest I_m,ij of each pixel."""
        return self._of_pixels(self.entries.values, "max")

    @cached_property
    def total(self) -> Tensor:
        """I_m,sum,i `[n_t]` in cd, with all pixels full."""
        return self._of_texels(self.entries.values, "sum")

    @cached_property
    def full(self) -> Csr:
        """`I_m^a_r / sum_i I_m^a_r` `[n_p, n_t]`, T eq. 7.4.5 with unit weights: rows add up to one."""
        raised = self._raised()
        return self.entries.with_values(raised / self._of_pixels(raised, "sum")[self._pixel()])

    @cached_property
    def kept(self) -> Tensor:
        """Weights `I_m^a_r` `[nnz]` without entries dropped by sampling or by the exclusion of T eq. 7.4.3; a pixel's add up to one."""
        params = self.params
        excludes = params.exclusion == "capability" and params.a_x and params.shape == "arbitrary"
        if params.sampling == "all" and not excludes:
            return self.full.values
        pixel, I_m = self._pixel(), self.entries.values
        chosen = self._raised() * sample_weights(self.entries, self.grid, params.sampling)
        if excludes:
            chosen = torch.where(I_m < params.a_x * self.peak[pixel], 0.0, chosen)  # T eq. 7.4.3 on the capability
        counted = self._of_pixels(chosen, "sum")
        kept = chosen / torch.where(counted == 0, 1.0, counted)[pixel]
        return self.full.values if bool((kept == self.full.values).all()) else kept

    @cached_property
    def weight(self) -> Csr:
        """Those of `kept` that are not zero, `[n_p, n_t]`."""
        if self.kept is self.full.values:
            return self.full
        return Csr.from_scipy(self.entries.with_values(self.kept).to_scipy(), self.kept.dtype).to(self.kept.device)

    @cached_property
    def idle(self) -> Tensor | None:
        """Pixels without weighted entries, `[n_p]` bool, None if there are none."""
        idle = self._of_pixels(self.kept, "sum") == 0
        return idle if bool(idle.any()) else None

    @cached_property
    def least_lit(self) -> Tensor:
        """How many of a pixel's setpoints have to be lit for its share to be a_ac, `[n_p]`."""
        # In whole numbers, since no product of floats tells 7 of 25 texels from a share of 0.28; str gives the decimal that was written.
        sizes, size_of_pixel = self.entries.indptr.diff().unique(return_inverse=True)
        least = [math.ceil(Fraction(str(self.params.a_ac)) * size) for size in sizes.tolist()]
        return self.entries.values.new_tensor(least)[size_of_pixel]

    @cached_property
    def darkening(self) -> Tensor | None:
        """Edge darkening `[n_t]` (T eq. 7.4.2), None without."""
        if self.params.a_d is None:
            return None
        mean = self.total[self.total > 0].double().mean().to(self.total)  # in float64, since the order of summation depends on threads
        return (self.total / (mean * self.params.a_d)).clamp(max=1)

    @cached_property
    def share(self) -> Tensor:
        """Factor `[n_t]` from intensity to the utilisation of all pixels of the texel; see `potential`."""
        if self.params.mapping == "direct":
            return torch.ones_like(self.total)
        if self.params.mapping == "maximal":
            sums = self._of_texels(self.entries.values, "amax")
        else:
            sums = self.total if self.potential is None else self._of_texels(self.entries.values * self.potential, "sum")
        return torch.where(sums > 0, 1 / sums, 0.0)

    @cached_property
    def potential(self) -> Tensor | None:
        """Factor `[nnz]` by which an entry's mapping differs from its texel's share, None where it is one.

        The mapped utilisation is `I_s,ij / I_m,ij = I_m,ij^(a_m - 1) / sum_j I_m,ij^a_m * I_s,i` (T eq. 7.4.1), the product of potential,
        share and I_s,i.
        """
        params, I_m = self.params, self.entries.values
        if params.mapping == "direct":
            return 1 / I_m
        if params.mapping == "maximal" or (params.a_m == 1 and params.granularity == 0):
            return None
        fine = (self._of_pixels(I_m, "sum") / self.peak)[self._pixel()] ** -params.granularity  # a pixel's size in texels
        return (I_m / self._of_texels(I_m, "amax")[self.entries.indices.long()]) ** (params.a_m - 1) * fine

    @cached_property
    def spread(self) -> tuple[float, float]:
        """Standard deviation of a pixel's light in rows and columns of texels."""
        return pixel_spread(self.entries, self.grid)

    @cached_property
    def pixels_of_rows(self) -> tuple[Tensor, Tensor]:
        """First and last pixel with a texel in each row of texels, `[rows]` each."""
        return segment_bounds(self.entries.indices // self.grid.cols, self._pixel(), self.grid.rows)

    @cached_property
    def rows_of_pixels(self) -> tuple[Tensor, Tensor]:
        """First and last row of texels of each pixel, `[n_p]` each."""
        return segment_bounds(self._pixel(), self.entries.indices // self.grid.cols, self.grid.n_pixels)

    def _raised(self) -> Tensor:
        """`(I_m,ij / I_m,j)^a_r` `[nnz]`."""
        return ((self.entries.values / self.peak[self._pixel()]) ** self.params.a_r).clamp(min=LEAST)

    def _pixel(self) -> Tensor:
        return row_of_entries(self.entries)

    def _of_pixels(self, values: Tensor, reduction: str) -> Tensor:
        """Sum or maximum `[n_p]` of entries `[nnz]`, 0 of a pixel without any."""
        return torch.segment_reduce(values, reduction, offsets=self.entries.indptr, initial=0)

    def _of_texels(self, values: Tensor, reduction: str) -> Tensor:
        texel = self.entries.indices.long()
        return values.new_zeros(self.entries.n_cols).scatter_reduce(0, texel, values, reduction, include_self=False)
