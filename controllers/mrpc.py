"""MapReduce pixel control (T 7.4): from ray setpoints to pixel utilisations, exact on every entry of the headlight matrix.

Where all pixels of a texel are asked for the same utilisation, the sums of (7.4.5) are products of the pixel-major matrix with images on
the texture; else they are taken entry by entry. Finite and infinite weights are two cases, so that 0 inf and inf / inf never arise.
"""

from dataclasses import dataclass, replace

import torch
from kornia.filters import gaussian_blur2d
from torch import Tensor

from controllers.mrpc_params import MrpcParams
from controllers.pixel_major import PixelMajor, pixel_major
from controllers.primitives import E_V, I_V, U_REL
from controllers.rthc import Setpoints
from controllers.windows import Window
from world.spmv import Csr, multiply, row_of_entries

__all__ = ["MrpcParams", "PixelMajor", "pixel_major", "reduce_setpoints"]


@dataclass(frozen=True)
class _Sums:
    """Of each pixel of a band, all `[..., band]`: numerator and denominator of (7.4.5) over its rays of finite weight, the denominator
    None where it is one; the same over its rays of infinite weight, None where there are none; and how many of its setpoints are lit.
    """

    light: Tensor
    weight: Tensor | None
    forced_light: Tensor | None = None
    forced_weight: Tensor | None = None
    lit: Tensor | None = None


def reduce_setpoints(
    setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool = False
) -> tuple[Tensor, slice]:
    """Map and reduce (7.4.1 to 7.4.5): utilisation `[..., n_p]` in 0..1 and the band of pixels that may differ from the default.

    default: `[n_p]`; a ray without a hit counts with `I_m,ij u_def,j` and weight 1. dark: the default is zero.
    """
    batch = setpoints.value.shape[:-2]
    if setpoints.window.empty:
        return default.expand(*batch, -1), slice(0, 0)
    band, rows = _touched(pixels, setpoints.window)
    if band.stop == band.start:
        return default.expand(*batch, -1), band
    if params.sharpening:
        setpoints = replace(setpoints, value=setpoints.value * _sharpened(setpoints, pixels, params, dark))
    sums = _by_products if _same_for_all_pixels(setpoints, pixels, params, dark) else _by_entries
    u = default.expand(*batch, -1).clone()
    u[..., band] = _reduced(sums(setpoints, pixels, params, default, dark, band, rows), pixels, params, default[band], band)
    return u, band


def _same_for_all_pixels(setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, dark: bool) -> bool:
    """Whether every ray asks all pixels of its texel for one utilisation (or one share of their default, if no bound cuts that)."""
    if params.upper_cd is not None or params.lower_cd or (params.a_x and params.exclusion == "printed"):
        return False
    if U_REL in setpoints.quantities and not dark:
        if setpoints.value.device.type != "cpu":
            return False  # to know whether a share is more than one, the device would have to be waited for
        if bool((setpoints.value * _portion(setpoints, setpoints.relative, U_REL)).max() > 1):
            return False
    return pixels.potential is None or not {I_V, E_V} & set(setpoints.quantities)


def _none(portion: Tensor | float) -> bool:
    return isinstance(portion, float) and not portion


def _portion(setpoints: Setpoints, image: Tensor | None, *codes: int) -> Tensor | float:
    """One where a ray has one of these quantities: the image of it, or a number where all rays are alike."""
    return float(setpoints.quantities[0] in codes) if image is None else image


def _blended(a: Tensor, b: Tensor, portion: Tensor | float) -> Tensor:
    """a where the portion is zero, b where it is one."""
    if isinstance(portion, float):
        return b if portion else a
    return torch.lerp(a, b, portion)


def _by_products(
    setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, band: slice, rows: slice
) -> _Sums:
    """Sums as products of images on the texture with the pixel-major matrices."""
    grid, w = pixels.grid, setpoints.window
    kept, full = pixels.weight.band(band.start, band.stop), pixels.full.band(band.start, band.stop)

    def summed(matrix: Csr, image: Tensor, beside: float = 0.0) -> Tensor:
        return multiply(matrix, _as_texture(image, w, rows, grid.rows, grid.cols, beside))

    value = setpoints.value
    utilisation = value
    in_cd, relative = _portion(setpoints, setpoints.in_cd, I_V, E_V), _portion(setpoints, setpoints.relative, U_REL)
    if not _none(in_cd):
        utilisation = _blended(value, value * pixels.share.view(grid.rows, grid.cols)[w.slices], in_cd)
    if pixels.darkening is not None:
        utilisation = utilisation * pixels.darkening.view(grid.rows, grid.cols)[w.slices]
    utilisation = utilisation.clamp(0, 1)
    of_default = None if dark or _none(relative) else utilisation * relative
    absolute = utilisation if _none(relative) else utilisation * (1 - relative)

    def light(matrix: Csr, weight: Tensor | None) -> Tensor:
        lit = summed(matrix, absolute if weight is None else absolute * weight)
        return lit if of_default is None else lit + default[band] * summed(matrix, of_default if weight is None else of_default * weight)

    denominator = forced_light = forced_weight = lit = None
    numerator = light(kept, setpoints.finite)
    if not dark:
        missed = 1 - summed(kept, setpoints.cover) if setpoints.finite is None else summed(kept, 1 - setpoints.cover, 1.0)
        numerator = numerator + missed * default[band]
    if setpoints.finite is not None:
        denominator = summed(kept, setpoints.finite, 1.0)
    if setpoints.forced is not None:
        forced_weight = summed(full, setpoints.forced)
        forced_light = torch.zeros_like(forced_weight) if setpoints.masking else light(full, setpoints.forced)
    if params.a_ac:
        ones = pixels.ones.band(band.start, band.stop)
        lit = summed(ones, (absolute > 0).to(value))
        if not dark:
            missed = summed(ones, 1 - setpoints.cover, 1.0)
            missed = missed if of_default is None else missed + summed(ones, (of_default > 0).to(value))
            lit = lit + (default[band] > 0) * missed
    return _Sums(numerator, denominator, forced_light, forced_weight, lit)


def _by_entries(
    setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, band: slice, rows: slice
) -> _Sums:
    """The same entry by entry, with every bound."""
    grid, w = pixels.grid, setpoints.window
    entries = pixels.entries.band(band.start, band.stop)
    pixel, texel, I_m = row_of_entries(entries), entries.indices.long(), entries.values
    place = slice(int(pixels.entries.indptr[band.start]), int(pixels.entries.indptr[band.stop]))

    def of_entries(image: Tensor, beside: float = 0.0) -> Tensor:
        return _as_texture(image, w, rows, grid.rows, grid.cols, beside)[..., texel]

    value, cover = of_entries(setpoints.value), of_entries(setpoints.cover)
    in_cd, relative = (
        portion if isinstance(portion, float) else of_entries(portion)
        for portion in (_portion(setpoints, setpoints.in_cd, I_V, E_V), _portion(setpoints, setpoints.relative, U_REL))
    )
    weight = None if setpoints.finite is None else of_entries(setpoints.finite, 1.0)
    forced = None if setpoints.forced is None else of_entries(setpoints.forced)
    shared = value * pixels.share[texel]
    shared = shared if pixels.potential is None else shared * pixels.potential[place]
    mapped = _blended(_blended(value, value * default[band][pixel], relative), shared, in_cd)
    if pixels.darkening is not None:
        mapped = mapped * pixels.darkening[texel]
    if params.lower_cd:
        masked = torch.zeros_like(cover, dtype=torch.bool) if forced is None else (forced > 0) & (value == 0)
        mapped = torch.where(masked, 0.0, mapped.maximum(params.lower_cd / I_m))
    if params.upper_cd is not None:
        mapped = mapped.minimum(params.upper_cd / I_m)
    mapped = torch.where(cover > 0, mapped.clamp(0, 1), default[band][pixel])
    kept = pixels.kept[place]
    if params.a_x and params.exclusion == "printed":
        kept = torch.where(mapped * I_m <= params.a_x * pixels.peak[band][pixel], 0.0, kept)

    def summed(terms: Tensor) -> Tensor:
        zeros = torch.zeros(*mapped.shape[:-1], entries.n_rows, dtype=terms.dtype, device=terms.device)
        return zeros.index_add(-1, pixel, terms.expand(*mapped.shape[:-1], -1))

    lit = summed((mapped > 0).to(mapped)) if params.a_ac else None
    finite = kept if weight is None else weight * kept
    forced_light = forced_weight = None
    if forced is not None:
        alone = forced * pixels.full.values[place]
        forced_light, forced_weight = summed(alone * mapped), summed(alone)
    return _Sums(summed(finite * mapped), summed(finite), forced_light, forced_weight, lit)


def _reduced(sums: _Sums, pixels: PixelMajor, params: MrpcParams, default: Tensor, band: slice) -> Tensor:
    """Utilisation `[..., band]` of sums: infinite weights first, then the default where nothing counts, then the activation threshold."""
    u = sums.light
    if sums.weight is not None:
        counts = sums.weight > 0
        u = torch.where(counts, u / torch.where(counts, sums.weight, 1.0), default)
    if sums.lit is not None:
        off = sums.lit < params.a_ac * pixels.reached[band]
        u = torch.where(off if sums.weight is None else off & counts, 0.0, u)
    if sums.forced_light is not None and sums.forced_weight is not None:
        forced = sums.forced_weight > 0
        u = torch.where(forced, sums.forced_light / torch.where(forced, sums.forced_weight, 1.0), u)
    return u.clamp(0, 1)


def _sharpened(setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, dark: bool) -> Tensor:
    """By how much setpoints are raised for the darkness beside them, blurred as a pixel's light is (T 7.5.2): `[..., rows, cols]`.

    Darkness is what a setpoint misses to the greatest in view, in cd. Where no primitive is hit it is dark if the base pattern is.
    """
    grid, w = pixels.grid, setpoints.window
    total = pixels.total.view(grid.rows, grid.cols)[w.slices]
    level = _blended(setpoints.value * total, setpoints.value, _portion(setpoints, setpoints.in_cd, I_V, E_V))
    bright = (level / level.amax((-2, -1), keepdim=True).clamp(min=1e-30)).clamp(0, 1)
    lit = bright if dark else torch.lerp(torch.ones_like(bright), bright, setpoints.cover)
    sigma = (max(pixels.spread[0], 0.3), max(pixels.spread[1], 0.3))
    kernel = (2 * round(3 * sigma[0]) + 1, 2 * round(3 * sigma[1]) + 1)
    margins = (kernel[1] // 2, kernel[1] // 2, kernel[0] // 2, kernel[0] // 2)
    lit = torch.nn.functional.pad(lit, margins, value=0.0 if dark else 1.0)
    flat = lit.reshape(-1, 1, *lit.shape[-2:])
    blurred = gaussian_blur2d(flat, kernel, sigma, border_type="constant").reshape(lit.shape)
    rows, cols = bright.shape[-2:]
    return 1 + params.sharpening * (1 - blurred[..., margins[2] : margins[2] + rows, margins[0] : margins[0] + cols])


def _touched(pixels: PixelMajor, w: Window) -> tuple[slice, slice]:
    """The contiguous band of pixels with texels in the window's rows, and all texture rows that those pixels have."""
    grid = pixels.grid
    if (w.row_start, w.row_stop) == (0, grid.rows):
        return slice(0, grid.n_pixels), slice(0, grid.rows)
    first = min(int(pixels.pixel_first[w.row_start : w.row_stop].min()), grid.n_pixels)
    band = slice(first, max(int(pixels.pixel_last[w.row_start : w.row_stop].max()) + 1, first))
    if band.stop == band.start:
        return band, slice(w.row_start, w.row_stop)
    low = min(int(pixels.row_first[band].min()), w.row_start)
    return band, slice(low, max(int(pixels.row_last[band].max()) + 1, w.row_stop))


def _as_texture(image: Tensor, w: Window, rows: slice, n_rows: int, n_cols: int, beside: float) -> Tensor:
    """Texels `[..., rows * cols]` of an image on a window, a constant beside it; beyond these rows they are undefined and never read."""
    texture = image.new_empty(*image.shape[:-2], n_rows, n_cols)
    texture[..., rows, :] = beside
    texture[..., *w.slices] = image
    return texture.flatten(-2)
