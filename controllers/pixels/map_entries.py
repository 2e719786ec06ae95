"""Mapping for each entry of the headlight matrix, with all bounds (T 7.4.1, eq. 7.4.1 to 7.4.3)."""

import torch
from torch import Tensor

from luxloop.controllers.pixels.map_sums import Band, Sums
from luxloop.controllers.pixels.mrpc_params import MrpcParams
from luxloop.controllers.pixels.pixel_major import PixelMajor
from luxloop.controllers.pixels.primitives import E_V, I_V, U_REL
from luxloop.controllers.pixels.rthc import Setpoints
from luxloop.world.spmv import row_of_entries


def by_entries(setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, default: Tensor, place: Band) -> Sums:
    """The sums of T eq. 7.4.5 over the entries of a band of pixels, mapped by T eq. 7.4.1 to 7.4.3. default: `[n_p]`."""
    band = place.pixels
    entries = pixels.entries.band(band.start, band.stop)
    pixel, texel, I_m = row_of_entries(entries), entries.indices.long(), entries.values
    own = slice(None)
    if entries is not pixels.entries:
        own = slice(int(pixels.entries.indptr[band.start]), int(pixels.entries.indptr[band.stop]))

    def of_entries(image: Tensor, beside: float = 0.0) -> Tensor:
        return place.texture(image, setpoints.window, pixels.grid, beside)[..., texel]

    value, cover = of_entries(setpoints.value), of_entries(setpoints.cover)
    in_cd, relative = (
        portion if isinstance(portion, float) else of_entries(portion)
        for portion in (setpoints.portion(setpoints.in_cd, I_V, E_V), setpoints.portion(setpoints.relative, U_REL))
    )
    weight = None if setpoints.finite is None else of_entries(setpoints.finite, 1.0)
    forced = None if setpoints.forced is None else of_entries(setpoints.forced)
    shared = value * pixels.share[texel]  # utilisations [..., nnz] of T eq. 7.4.1
    shared = shared if pixels.potential is None else shared * pixels.potential[own]
    mapped = _blended(_blended(value, value * default[band][pixel], relative), shared, in_cd)  # u_abs, u_rel or cd (T 7.2.1), [..., nnz]
    if pixels.darkening is not None:
        mapped = mapped * pixels.darkening[texel]  # T eq. 7.4.2
    if params.lower_cd:
        masked = torch.zeros_like(cover, dtype=torch.bool) if forced is None else (forced > 0) & (value == 0)
        mapped = torch.where(masked, 0.0, mapped.maximum(params.lower_cd / I_m))  # the user's lower bound (T 7.4.1)
    if params.upper_cd is not None:
        mapped = mapped.minimum(params.upper_cd / I_m)  # the user's upper bound (T 7.4.1)
    mapped = torch.where(cover > 0, mapped.clamp(0, 1), default[band][pixel])  # 0 <= I_s,ij <= I_m,ij; u_def,j without a hit
    kept = pixels.kept[own]
    if params.a_x and params.exclusion == "printed":
        kept = torch.where(mapped * I_m <= params.a_x * pixels.peak[band][pixel], 0.0, kept)  # T eq. 7.4.3 as printed

    def summed(terms: Tensor) -> Tensor:
        zeros = torch.zeros(*mapped.shape[:-1], entries.n_rows, dtype=terms.dtype, device=terms.device)
        return zeros.index_add(-1, pixel, terms.expand(*mapped.shape[:-1], -1))

    lit = summed((mapped > 0).to(mapped)) if params.a_ac else None
    finite = kept if weight is None else weight * kept  # w_ij I_m,ij^a_r of T eq. 7.4.5, [..., nnz]
    forced_light = forced_weight = None
    if forced is not None:
        alone = forced * pixels.full.values[own]
        forced_light, forced_weight = summed(alone * mapped), summed(alone)  # T eq. 7.4.5 over infinite weights, [..., band]
    return Sums(summed(finite * mapped), summed(finite), forced_light, forced_weight, lit)


def _blended(a: Tensor, b: Tensor, portion: Tensor | float) -> Tensor:
    """a where portion is 0, b where it is 1."""
    if isinstance(portion, float):
        return b if portion else a
    return torch.lerp(a, b, portion)
