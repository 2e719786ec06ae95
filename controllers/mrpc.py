"""MapReduce pixel control (T 7.4): from ray setpoints to pixel utilisations, exact on every entry of the headlight matrix."""

from dataclasses import dataclass

import torch
from torch import Tensor

from controllers.primitives import Quantity
from controllers.rthc import Setpoints, Window
from world.headlight import Headlight
from world.params import Params
from world.spmv import Csr, multiply, row_of_entries, segment_bounds


class MrpcParams(Params):
    """Exponents of mapping and reduction (T 7.4.1, 7.4.5)."""

    a_m: float = 1.0
    a_r: float = 1.0


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
    setpoints: Setpoints, quantity: Quantity, headlight: Headlight, pixels: PixelMajor, params: MrpcParams, default: Tensor
) -> tuple[Tensor, slice]:
    """Map and reduce (7.4.1, 7.4.5): utilisation `[..., n_p]` in 0..1 and the band of pixels that may differ from the default.

    default: `[n_p]`; a ray without a hit counts with `I_m,ij u_def,j`. With a_m = 1 the upper bound `I_s,ij <= I_m,ij` is the same for all
    pixels of a texel and the mapping folds into the reduction's matrix; with any other a_m it is taken entry by entry.
    """
    w = setpoints.window
    batch = setpoints.value.shape[:-2]
    if w.row_stop <= w.row_start or w.col_stop <= w.col_start:
        return default.expand(*batch, -1), slice(0, 0)
    band, rows = _touched(pixels, w.row_start, w.row_stop, headlight)
    value = _on_rows(setpoints.value, w, rows, headlight.cols)
    hit = _on_rows(setpoints.hit.to(value), w, rows, headlight.cols)
    first_texel = rows.start * headlight.cols
    if params.a_m == 1 or quantity in ("u_abs", "u_rel"):
        if quantity in ("I_v", "E_v"):
            value = (value * pixels.share[first_texel : first_texel + value.shape[-1]]).clamp(0, 1)
        weight = _shift(pixels.weight.band(band.start, band.stop), first_texel, value.shape[-1])
        mapped, covered = multiply(weight, value), multiply(weight, hit)
        if quantity == "u_rel":
            mapped = mapped * default[band]
    else:
        mapped, covered = _entrywise(value, hit, pixels, params, band, first_texel)
    u = default.expand(*batch, -1).clone()
    u[..., band] = (mapped + (1 - covered) * default[band]).clamp(0, 1)
    return u, band


def _entrywise(
    value: Tensor, hit: Tensor, pixels: PixelMajor, params: MrpcParams, band: slice, first_texel: int
) -> tuple[Tensor, Tensor]:
    entries = pixels.entries.band(band.start, band.stop)
    weight = pixels.weight.band(band.start, band.stop).values
    texel = entries.indices.long() - first_texel
    share = value * pixels.share[first_texel : first_texel + value.shape[-1]]
    utilisation = (share[..., texel] * entries.values ** (params.a_m - 1)).clamp(0, 1)
    pixel = row_of_entries(entries)
    zeros = torch.zeros(*value.shape[:-1], entries.n_rows, dtype=value.dtype, device=value.device)
    return zeros.index_add(-1, pixel, weight * utilisation), zeros.index_add(-1, pixel, weight * hit[..., texel])


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


def _on_rows(image: Tensor, w: Window, rows: slice, cols: int) -> Tensor:
    padding = (w.col_start, cols - w.col_stop, w.row_start - rows.start, rows.stop - w.row_stop)
    return torch.nn.functional.pad(image, padding).flatten(-2)


def _shift(matrix: Csr, first_col: int, n_cols: int) -> Csr:
    return Csr(matrix.indptr, matrix.indices - first_col if first_col else matrix.indices, matrix.values, n_cols)
