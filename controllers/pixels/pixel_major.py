"""Pixel-major tables of a headlight for MRPC, independent of setpoints (T 7.4)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
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
Reduce = Callable[[Tensor, str], Tensor]  # values `[nnz]` of entries, not below zero, and sum or amax


@dataclass(frozen=True)
class PixelMajor:
    """Tables of a headlight for MRPC, pixel-major.

    entries: `[n_p, n_t]`, I_m,ij. full: the same with `I_m^a_r / sum_i I_m^a_r`, rows add up to one. kept: `[nnz]`, weights `I_m^a_r`
    without entries dropped by exclusion or sampling, a pixel's adding up to one. weight: `[n_p, n_t]`, those that are not zero. share:
    `[n_t]`, factor from intensity to the utilisation of all pixels of the texel; potential: `[nnz]`, the factor by which an entry's
    differs, None where it is one. total: `[n_t]`, cd with all pixels full. darkening: `[n_t]` (T eq. 7.4.2). least_lit: `[n_p]`, how many
    of a pixel's setpoints have to be lit for its share to be a_ac. idle: `[n_p]`, pixels without weighted entries, None if there are none.
    ones: the pattern of entries. peak: `[n_p]`, greatest I_m,ij. spread: standard deviation of a pixel's light in rows and columns, 0 where
    unused. pixel_first, pixel_last: `[rows]`, pixels with a texel in that texture row. row_first, row_last: `[n_p]`, texture rows of that
    pixel.
    """

    grid: Headlight
    entries: Csr
    full: Csr
    kept: Tensor
    weight: Csr
    share: Tensor
    potential: Tensor | None
    total: Tensor
    darkening: Tensor | None
    least_lit: Tensor
    idle: Tensor | None
    ones: Csr
    peak: Tensor
    spread: tuple[float, float]
    pixel_first: Tensor
    pixel_last: Tensor
    row_first: Tensor
    row_last: Tensor


def pixel_major(headlight: Headlight, params: MrpcParams) -> PixelMajor:
    """The tables of a headlight for parameters of MRPC: the weights of T eq. 7.4.5 with the exclusion of T eq. 7.4.3."""
    entries = headlight.matrix.transpose
    if params.shape == "rectangle":
        entries = rectangular(entries, headlight, params.a_x or 0.5)
    pixel, texel, I_m = row_of_entries(entries), entries.indices.long(), entries.values

    def of_pixels(values: Tensor, reduction: str) -> Tensor:
        return torch.segment_reduce(values, reduction.removeprefix("a"), offsets=entries.indptr, initial=0)  # 0 of a pixel without any

    def of_texels(values: Tensor, reduction: str) -> Tensor:
        return values.new_zeros(entries.n_cols).scatter_reduce(0, texel, values, reduction, include_self=False)

    peak, total = of_pixels(I_m, "amax"), of_texels(I_m, "sum")  # I_m,j [n_p] and I_m,sum,i [n_t]
    raised = ((I_m / peak[pixel]) ** params.a_r).clamp(min=LEAST)  # (I_m,ij / I_m,j)^a_r [nnz]
    full = entries.with_values(raised / of_pixels(raised, "sum")[pixel])  # T eq. 7.4.5 with unit weights, [nnz]
    chosen = raised * sample_weights(entries, headlight, params.sampling)
    if params.exclusion == "capability" and params.a_x and params.shape == "arbitrary":
        chosen = torch.where(I_m < params.a_x * peak[pixel], 0.0, chosen)  # T eq. 7.4.3 on the capability
    counted = of_pixels(chosen, "sum")
    idle = counted == 0
    kept = chosen / torch.where(idle, 1.0, counted)[pixel]
    share, potential = _mapping(params, entries, pixel, total, of_pixels, of_texels)
    darkening = None
    if params.a_d is not None:
        mean = total[total > 0].double().mean().to(total)  # in float64, since the order of summation depends on threads
        darkening = (total / (mean * params.a_d)).clamp(max=1)  # T eq. 7.4.2
    rows, reached = texel // headlight.cols, of_pixels(torch.ones_like(I_m), "sum")
    # In whole numbers, since no product of floats tells 7 of 25 texels from a share of 0.28; str gives the decimal that was written.
    sizes, size_of_pixel = reached.unique(return_inverse=True)
    least_lit = reached.new_tensor([math.ceil(Fraction(str(params.a_ac)) * int(size)) for size in sizes.tolist()])[size_of_pixel]
    return PixelMajor(
        headlight,
        entries,
        full,
        kept,
        full if bool((kept == full.values).all()) else Csr.from_scipy(entries.with_values(kept).to_scipy(), kept.dtype).to(kept.device),
        share,
        potential,
        total,
        darkening,
        least_lit,
        idle if bool(idle.any()) else None,
        entries.with_values(torch.ones_like(I_m)),
        peak,
        pixel_spread(entries, headlight) if params.sharpening else (0.0, 0.0),
        *segment_bounds(rows, pixel, headlight.rows),
        *segment_bounds(pixel, rows, headlight.n_pixels),
    )


def _mapping(
    params: MrpcParams, entries: Csr, pixel: Tensor, total: Tensor, of_pixels: Reduce, of_texels: Reduce
) -> tuple[Tensor, Tensor | None]:
    """share `[n_t]` and potential `[nnz]` of T eq. 7.4.1, or of the direct or maximal mapping. total: `[n_t]`, sum_j I_m,ij.

    The mapped utilisation is `I_s,ij / I_m,ij = I_m,ij^(a_m - 1) / sum_j I_m,ij^a_m * I_s,i`, the product of potential, share and I_s,i.
    """
    I_m = entries.values
    if params.mapping == "direct":
        return torch.ones(entries.n_cols, dtype=I_m.dtype, device=I_m.device), 1 / I_m
    if params.mapping == "maximal":
        strongest = of_texels(I_m, "amax")
        return torch.where(strongest > 0, 1 / strongest, 0.0), None
    sum_of_potentials, potential = total, None
    if params.a_m != 1 or params.granularity != 0:
        fine = (of_pixels(I_m, "sum") / of_pixels(I_m, "amax"))[pixel] ** -params.granularity  # a pixel's size in texels
        relative = (I_m / of_texels(I_m, "amax")[entries.indices.long()]) ** (params.a_m - 1)
        sum_of_potentials, potential = of_texels(I_m * relative * fine, "sum"), relative * fine
    return torch.where(sum_of_potentials > 0, 1 / sum_of_potentials, 0.0), potential
