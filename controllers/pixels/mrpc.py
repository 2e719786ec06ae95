"""MapReduce pixel control (T 7.4): from ray setpoints to pixel utilisations, exact on every entry of the headlight matrix.

If a setpoint is the same utilisation for all pixels of a texel, the sums of T eq. 7.4.5 are products of the pixel-major matrix with images
on the texture; otherwise they run over the entries. Finite and infinite weights are summed separately, so that 0 inf and inf / inf never
arise.
"""

from dataclasses import replace

import torch
from torch import Tensor

from luxloop.controllers.pixels.mapping import Band, Sums, sums_by_entries, sums_by_products
from luxloop.controllers.pixels.pixel_major import MrpcParams, PixelMajor
from luxloop.controllers.pixels.primitives import E_V, I_V, U_REL
from luxloop.controllers.pixels.rthc import RayBatch, Setpoints
from luxloop.world.errors import LuxloopError
from luxloop.world.spmv import multiply

FAINT = 1e-6  # least share of a setpoint after a correction, so that a lit setpoint stays lit


def correct(asked: Setpoints, wanted: Setpoints, u: Tensor, pixels: PixelMajor, default: Tensor) -> Setpoints:
    """The setpoints of the last pass, plus the error of the light of utilisations u `[..., n_p]` against the wanted setpoints; not from the
    thesis.

    Van Cittert's deconvolution with MRPC in place of the blur's inverse: the error is that of all pixels together, and MRPC again computes
    pixel by pixel. Dark, lit and missed setpoints stay dark, lit and missed. default: `[n_p]`. Costs one product with the matrix.
    """
    grid, w = pixels.grid, wanted.window
    band = grid.matrix.band(w.v_start * grid.cols, w.v_stop * grid.cols)

    def on_window(texels: Tensor) -> Tensor:
        return texels.unflatten(-1, (-1, grid.cols))[..., w.slices[1]]

    in_cd, relative = wanted.portion(wanted.in_cd, I_V, E_V), wanted.portion(wanted.relative, U_REL)
    unit = in_cd + (1 - in_cd - relative) * pixels.total.view(grid.rows, grid.cols)[w.slices]
    if U_REL in wanted.quantities:
        unit = unit + relative * on_window(multiply(band, default))
    if pixels.darkening is not None:
        unit = unit * pixels.darkening.view(grid.rows, grid.cols)[w.slices]
    given = on_window(multiply(band, u)) / unit.masked_fill(unit == 0, torch.inf)
    return replace(asked, value=(asked.value + wanted.value - given).maximum(FAINT * wanted.value))  # s + w - A u / unit, [..., rows, cols]


def sharpen(setpoints: Setpoints, pixels: PixelMajor, strength: float, dark: bool) -> Setpoints:
    """Setpoints raised by the darkness around them, blurred like a pixel's light (T 7.5.2). dark: whether the base pattern is zero.

    Darkness is the relative difference of a setpoint in cd to the greatest one in the window. Rays without a hit are dark if the base
    pattern is.
    """
    from kornia.filters import gaussian_blur2d

    grid, w = pixels.grid, setpoints.window
    total = pixels.total.view(grid.rows, grid.cols)[w.slices]
    in_cd = setpoints.portion(setpoints.in_cd, I_V, E_V)
    level = setpoints.value * (in_cd + total * (1 - in_cd))
    bright = (level / level.amax((-2, -1), keepdim=True).clamp(min=1e-30)).clamp(0, 1)
    lit = bright if dark else torch.lerp(torch.ones_like(bright), bright, setpoints.cover)
    sigma = (max(pixels.spread[0], 0.3), max(pixels.spread[1], 0.3))
    kernel = (2 * round(3 * sigma[0]) + 1, 2 * round(3 * sigma[1]) + 1)
    margins = (kernel[1] // 2, kernel[1] // 2, kernel[0] // 2, kernel[0] // 2)
    lit = torch.nn.functional.pad(lit, margins, value=0.0 if dark else 1.0)
    flat = lit.reshape(-1, 1, *lit.shape[-2:])
    blurred = gaussian_blur2d(flat, kernel, sigma, border_type="constant").reshape(lit.shape)
    rows, cols = bright.shape[-2:]
    raised = 1 + strength * (1 - blurred[..., margins[2] : margins[2] + rows, margins[0] : margins[0] + cols])  # T 7.5.2, [..., rows, cols]
    return replace(setpoints, value=setpoints.value * raised)


def reduce_setpoints(
    asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool = False
) -> tuple[Tensor, slice]:
    """Map and reduce (T eq. 7.4.1 to 7.4.3, 7.4.5): utilisation `[..., n_p]` in 0..1, and the pixels that may differ from the default.

    asked: setpoints, or rays to cast, whose setpoints are then stored only where needed. default: `[n_p]`; a ray without a hit counts with
    `I_m,ij u_def,j` and weight 1. dark: whether the default is zero.
    """
    batch = tuple(asked.value.shape[:-2] if isinstance(asked, Setpoints) else asked.primitives.value.shape[:-1])
    place = Band.of_window(pixels, asked.window)
    band = place.pixels
    if band.stop == band.start:
        return default.expand(*batch, -1).clone(), band
    if not (params.sharpening or params.corrections):
        return _map_and_reduce(asked, pixels, params, default, dark, place, batch), band
    wanted = asked = asked if isinstance(asked, Setpoints) else asked.setpoints()
    if params.sharpening:
        asked = sharpen(wanted, pixels, params.sharpening, dark)
    u = _map_and_reduce(asked, pixels, params, default, dark, place, batch)
    for _ in range(params.corrections):
        asked = correct(asked, wanted, u, pixels, default)
        u = _map_and_reduce(asked, pixels, params, default, dark, place, batch)
    return u, band


def _map_and_reduce(
    asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, place: Band, batch: tuple[int, ...]
) -> Tensor:
    """Utilisation `[..., n_p]` of one mapping and reduction."""
    band, alike = place.pixels, same_for_all_pixels(asked, pixels, params, dark)
    if isinstance(asked, RayBatch) and not alike:
        asked = asked.setpoints()
    if isinstance(asked, Setpoints) and not alike:
        sums = sums_by_entries(asked, pixels, params, default, place)
    else:
        sums = sums_by_products(asked, pixels, params, default, dark, place, batch)
    changed = _reduce(sums, pixels, params, default[band], dark, band)
    if changed.shape[-1] == len(default):
        return changed
    u = default.expand(*batch, -1).clone()
    u[..., band] = changed
    return u


def same_for_all_pixels(asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, dark: bool) -> bool:
    """Whether each ray's setpoint is one utilisation for all pixels of its texel, or one share of their defaults without clipping."""
    if params.upper_cd is not None or params.lower_cd or (params.a_x and params.exclusion == "printed"):
        return False
    if U_REL in asked.quantities and not dark:
        shares = asked.shares
        if shares.device.type != "cpu" or bool(shares.max() > 1) or params.sharpening or params.corrections:
            return False  # reading the shares would wait for the device
    return pixels.potential is None or not {I_V, E_V} & set(asked.quantities)


def _reduce(sums: Sums, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, band: slice) -> Tensor:
    """Utilisation `[..., band]` from the sums (T eq. 7.4.5). Infinite weights override finite ones; pixels without weight keep the default;
    then a_ac applies.
    """
    u, idle = sums.weighted_u, None if pixels.idle is None else pixels.idle[band]
    if sums.weight is not None:
        u = u / sums.weight.clamp(min=torch.finfo(u.dtype).tiny)  # T eq. 7.4.5: weighted mean of the ray setpoints; tiny prevents 0 / 0
        idle = None if dark and sums.lit is None else sums.weight == 0
    if idle is not None:
        u = u + default * idle  # all weights vanish: the pixel keeps its default
    if sums.lit is not None:
        on = sums.lit >= pixels.least_lit[band]  # activation by the share a_ac of lit setpoints (T 7.5.2)
        u = u * (on if idle is None else on | idle)
    if sums.weight is not None and sums.ruled_from is not None:
        u = u * (sums.weight < sums.ruled_from).to(u)  # an infinite weight of a zero setpoint: dark
    if sums.forced_u is not None and sums.forced_weight is not None:
        forced = sums.forced_weight > 0
        # T eq. 7.4.5 over infinite weights only, [..., band].
        u = torch.where(forced, sums.forced_u / torch.where(forced, sums.forced_weight, 1.0), u)
    return u.clamp(0, 1)


def limit_power(u: Tensor, power: Tensor | float, limit: float | Tensor) -> tuple[Tensor, Tensor]:
    """Dim all pixels by one factor so that a lamp keeps its power limit (T 7.4.1).

    u: `[..., n_p]`, utilisations of all of the lamp's modules in turn. power: of each pixel at full utilisation, `[n_p]` or one value, in
    the unit of limit. Returns the utilisation and the factor `[...]`, 1 if the power is within the limit. Raises LuxloopError for a limit
    below zero.
    """
    if not isinstance(limit, Tensor) and limit < 0:
        raise LuxloopError(f"a power limit of {limit:g} is below zero: give 0 or more")
    total = (u * power).sum(-1)
    factor = torch.where(total > limit, limit / torch.where(total > 0, total, 1.0), 1.0)
    return u * factor[..., None], factor
