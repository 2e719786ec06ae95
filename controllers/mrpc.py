"""MapReduce pixel control (T 7.4): from ray setpoints to pixel utilisations, exact on every entry of the headlight matrix."""

from dataclasses import dataclass

import torch
from pydantic import Field
from torch import Tensor

from controllers.primitives import Quantity
from controllers.rthc import Setpoints, Window
from world.headlight import Headlight
from world.params import Params
from world.spmv import Csr, multiply, row_of_entries, segment_bounds


class MrpcParams(Params):
    """Exponents of mapping and reduction (T 7.4.1, 7.4.5)."""

    a_m: float = Field(1.0, ge=0, description="mapping: 0 shares a setpoint equally among its pixels, 1 by what they can give")
    a_r: float = Field(1.0, ge=0, description="reduction: 0 averages utilisations, 1 conserves light, 2 is the least-squares solution")


@dataclass(frozen=True)
class PixelMajor:
    """What MRPC needs of a headlight, pixel-major, made once.

    entries: `[n_p, n_t]`, I_m,ij. weight: `[n_p, n_t]`, `I_m^a_r / sum_i I_m^a_r`, rows add up to one. share: `[n_t]`, 1 / sum_j I_m^a_m.
    pixel_first, pixel_last: `[rows]`, pixels with a texel in that texture row. row_first, row_last: `[n_p]`, texture rows of that pixel.
    """

    entries: Csr
    weight: Csr
    share: Tensor
    pixel_first: Tensor
    pixel_last: Tensor
    row_first: Tensor
    row_last: Tensor


def pixel_major(headlight: Headlight, params: MrpcParams) -> PixelMajor:
    """Turn a headlight matrix around for MRPC."""
    entries = headlight.matrix.transposed
    pixel = row_of_entries(entries)
    texture_row = entries.indices.long() // headlight.cols
    raised = entries.values**params.a_r
    total = torch.zeros(headlight.n_pixels, dtype=raised.dtype, device=raised.device).index_add(0, pixel, raised)
    potential = torch.zeros(entries.n_cols, dtype=raised.dtype, device=raised.device)
    potential = potential.index_add(0, entries.indices.long(), entries.values**params.a_m)
    return PixelMajor(
        entries,
        entries.with_values(raised / total[pixel]),
        torch.where(potential > 0, 1 / potential, 0.0),
        *segment_bounds(texture_row, pixel, headlight.rows),
        *segment_bounds(pixel, texture_row, headlight.n_pixels),
    )


def reduce_setpoints(
    setpoints: Setpoints,
    quantity: Quantity,
    headlight: Headlight,
    pixels: PixelMajor,
    params: MrpcParams,
    default: Tensor,
    dark: bool = False,
) -> tuple[Tensor, slice]:
    """Map and reduce (7.4.1, 7.4.5): utilisation `[..., n_p]` in 0..1 and the band of pixels that may differ from the default.

    default: `[n_p]`; a ray without a hit counts with `I_m,ij u_def,j`. dark: the default is zero, so these rays need no counting.
    For u_abs, and for a_m = 1, all pixels of a texel get the same utilisation: it is bounded by `I_s,ij <= I_m,ij` once a texel and then
    reduced by a matrix; else everything goes entry by entry.
    """
    w = setpoints.window
    batch = setpoints.value.shape[:-2]
    if w.row_stop <= w.row_start or w.col_stop <= w.col_start:
        return default.expand(*batch, -1), slice(0, 0)
    band, rows = _touched(pixels, w.row_start, w.row_stop, headlight)
    weight = pixels.weight.band(band.start, band.stop)
    value = setpoints.value
    if quantity in ("I_v", "E_v"):
        value = value * pixels.share.view(headlight.rows, headlight.cols)[w.slices]
    if quantity == "u_abs" or (quantity != "u_rel" and params.a_m == 1):
        mapped = multiply(weight, _as_texture(value.clamp(0, 1), w, rows, headlight))
    else:
        factor = default if quantity == "u_rel" else None
        mapped = _entrywise(_as_texture(value, w, rows, headlight), factor, pixels, params, band)
    if not dark:
        covered = multiply(weight, _as_texture(setpoints.hit.to(value), w, rows, headlight))
        mapped = mapped + (1 - covered) * default[band]
    u = default.expand(*batch, -1).clone()
    u[..., band] = mapped.clamp(0, 1)
    return u, band


def _entrywise(texture: Tensor, factor: Tensor | None, pixels: PixelMajor, params: MrpcParams, band: slice) -> Tensor:
    """Reduce texels times a factor a pixel `[n_p]`, without one times `I_m^(a_m - 1)`, bounded entry by entry: `[..., band]`."""
    entries = pixels.entries.band(band.start, band.stop)
    weight = pixels.weight.band(band.start, band.stop).values
    pixel = row_of_entries(entries)
    potential = entries.values ** (params.a_m - 1) if factor is None else factor[band][pixel]
    utilisation = (texture[..., entries.indices.long()] * potential).clamp(0, 1)
    zeros = torch.zeros(*texture.shape[:-1], entries.n_rows, dtype=texture.dtype, device=texture.device)
    return zeros.index_add(-1, pixel, weight * utilisation)


def _touched(pixels: PixelMajor, row_start: int, row_stop: int, headlight: Headlight) -> tuple[slice, slice]:
    """The contiguous band of pixels with texels in these texture rows, and all texture rows that those pixels have."""
    if (row_start, row_stop) == (0, headlight.rows):
        return slice(0, headlight.n_pixels), slice(0, headlight.rows)
    first = min(int(pixels.pixel_first[row_start:row_stop].min()), headlight.n_pixels)
    band = slice(first, max(int(pixels.pixel_last[row_start:row_stop].max()) + 1, first))
    if band.stop == band.start:
        return band, slice(row_start, row_stop)
    low = min(int(pixels.row_first[band].min()), row_start)
    return band, slice(low, max(int(pixels.row_last[band].max()) + 1, row_stop))


def _as_texture(image: Tensor, w: Window, rows: slice, headlight: Headlight) -> Tensor:
    """Texels `[..., rows * cols]` of an image on a window, zero beside it; beyond these rows they are undefined and never read."""
    texture = image.new_empty(*image.shape[:-2], headlight.rows, headlight.cols)
    texture[..., rows, :] = 0
    texture[..., *w.slices] = image
    return texture.flatten(-2)
