"""Limit of the power of a whole lamp (T 7.4.1)."""

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import row_of_entries


def limit_power(u: Tensor, power: Tensor | float, limit: float | Tensor) -> tuple[Tensor, Tensor]:
    """Dim all pixels by one factor so that a lamp keeps its power limit (T 7.4.1).

    u: `[..., n_p]`, utilisations of all of the lamp's modules in turn. power: of each pixel at full utilisation, `[n_p]` or one value, in
    the unit of limit. Returns the utilisation and the factor `[...]`, 1 where the limit is kept anyway. Raises LuxloopError for a limit
    below zero.
    """
    if not isinstance(limit, Tensor) and limit < 0:
        raise LuxloopError(f"a power limit of {limit:g} is below zero: give 0 or more")
    total = (u * power).sum(-1)
    factor = torch.where(total > limit, limit / torch.where(total > 0, total, 1.0), 1.0)
    return u * factor[..., None], factor


def pixel_flux(headlight: Headlight) -> Tensor:
    """Luminous flux in lm of each pixel at full utilisation, `[n_p]`; proportional to power if all LEDs are equally efficient."""
    y, z = headlight.tangents(headlight.matrix.values.dtype, headlight.matrix.values.device)
    plane = (headlight.left - headlight.right) * (headlight.top - headlight.bottom) / headlight.n_texels
    solid_angle = plane / (1 + y * y + z[:, None] ** 2) ** 1.5
    entries = headlight.matrix.transpose
    flux = entries.values * solid_angle.flatten()[entries.indices.long()]
    return flux.new_zeros(headlight.n_pixels).index_add(0, row_of_entries(entries), flux)
