"""MapReduce pixel control (T 7.4): from ray setpoints to pixel utilisations, exact on every entry of the headlight matrix.

Where a setpoint is the same utilisation for all pixels of a texel, the sums of T eq. 7.4.5 are products of the pixel-major matrix with
images on the texture; otherwise they run over the entries. Finite and infinite weights are summed separately, so that 0 inf and inf / inf
never arise.
"""

import torch
from torch import Tensor

from luxloop.controllers.pixels.map_entries import by_entries
from luxloop.controllers.pixels.map_products import by_products
from luxloop.controllers.pixels.map_sums import Band, Sums
from luxloop.controllers.pixels.mrpc_params import MrpcParams
from luxloop.controllers.pixels.pixel_major import PixelMajor, pixel_major
from luxloop.controllers.pixels.primitives import E_V, I_V, U_REL
from luxloop.controllers.pixels.rthc import RayBatch, Setpoints
from luxloop.controllers.pixels.sharpening import corrected, sharpened

__all__ = ["MrpcParams", "PixelMajor", "pixel_major", "reduce_setpoints"]


def reduce_setpoints(
    asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool = False
) -> tuple[Tensor, slice]:
    """Map and reduce (T eq. 7.4.1 to 7.4.3, 7.4.5): utilisation `[..., n_p]` in 0..1, and the pixels that may differ from the default.

    asked: setpoints, or rays to cast, which avoids storing their setpoints where possible. default: `[n_p]`; a ray without a hit counts
    with `I_m,ij u_def,j` and weight 1. dark: whether the default is zero.
    """
    batch = tuple(asked.value.shape[:-2] if isinstance(asked, Setpoints) else asked.primitives.value.shape[:-1])
    place = Band.touched(pixels, asked.window)
    band = place.pixels
    if band.stop == band.start:
        return default.expand(*batch, -1).clone(), band
    if not (params.sharpening or params.corrections):
        return _mapped_and_reduced(asked, pixels, params, default, dark, place, batch), band
    wanted = asked = asked if isinstance(asked, Setpoints) else asked.setpoints()
    if params.sharpening:
        asked = sharpened(wanted, pixels, params.sharpening, dark)
    u = _mapped_and_reduced(asked, pixels, params, default, dark, place, batch)
    for _ in range(params.corrections):
        asked = corrected(asked, wanted, u, pixels, default)
        u = _mapped_and_reduced(asked, pixels, params, default, dark, place, batch)
    return u, band


def _mapped_and_reduced(
    asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, place: Band, batch: tuple[int, ...]
) -> Tensor:
    """Utilisation `[..., n_p]` of one mapping and reduction."""
    band, alike = place.pixels, same_for_all_pixels(asked, pixels, params, dark)
    if isinstance(asked, RayBatch) and not alike:
        asked = asked.setpoints()
    if isinstance(asked, Setpoints) and not alike:
        sums = by_entries(asked, pixels, params, default, place)
    else:
        sums = by_products(asked, pixels, params, default, dark, place, batch)
    changed = _reduced(sums, pixels, params, default[band], dark, band)
    if changed.shape[-1] == len(default):
        return changed
    u = default.expand(*batch, -1).clone()
    u[..., band] = changed
    return u


def same_for_all_pixels(asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, dark: bool) -> bool:
    """Whether each ray's setpoint is one utilisation for all pixels of its texel (or one share of their default that no bound cuts)."""
    if params.upper_cd is not None or params.lower_cd or (params.a_x and params.exclusion == "printed"):
        return False
    if U_REL in asked.quantities and not dark:
        shares = asked.shares
        if shares.device.type != "cpu" or bool(shares.max() > 1) or params.sharpening or params.corrections:
            return False  # reading the shares would wait for the device
    return pixels.potential is None or not {I_V, E_V} & set(asked.quantities)


def _reduced(sums: Sums, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, band: slice) -> Tensor:
    """Utilisation `[..., band]` of sums (T eq. 7.4.5). Infinite weights override; without any weight the default stays; then a_ac
    applies.
    """
    u, idle = sums.light, None if pixels.idle is None else pixels.idle[band]
    if sums.weight is not None:
        u = u / sums.weight.clamp(min=torch.finfo(u.dtype).tiny)  # T eq. 7.4.5: sum_i w_ij I_m,ij^a_r u_ij / sum_i w_ij I_m,ij^a_r
        idle = None if dark and sums.lit is None else sums.weight == 0
    if idle is not None:
        u = u + default * idle  # all weights vanish: the pixel keeps its default
    if sums.lit is not None:
        on = sums.lit >= pixels.least_lit[band]  # activation by the share a_ac of lit setpoints (T 7.5.2)
        u = u * (on if idle is None else on | idle)
    if sums.weight is not None and sums.ruled_from is not None:
        u = u * (sums.weight < sums.ruled_from).to(u)  # an infinite weight of a zero setpoint: dark
    if sums.forced_light is not None and sums.forced_weight is not None:
        forced = sums.forced_weight > 0
        # T eq. 7.4.5 over infinite weights only, [..., band].
        u = torch.where(forced, sums.forced_light / torch.where(forced, sums.forced_weight, 1.0), u)
    return u.clamp(0, 1)
