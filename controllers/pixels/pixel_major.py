"""Pixel-major tables of a headlight for MRPC, independent of setpoints (T 7.4)."""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.pixels.sampling import Sampling, pixel_spread, rectangular, sample_weights
from luxloop.world.headlight import Headlight
from luxloop.world.params import Params, Share, in_order
from luxloop.world.spmv import Csr, row_of_entries, segment_bounds


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
