"""The power of a whole lamp as a limit (T 7.4.1)."""

import torch
from torch import Tensor

from world.errors import LuxloopError
from world.headlight import Headlight
from world.spmv import row_of_entries


def limit_power(u: Tensor, power: Tensor | float, limit: float | Tensor) -> tuple[Tensor, Tensor]:
    """Dim all pixels alike until a lamp keeps its limit (T 7.4.1).

    u: `[..., n_p]`, of all of the lamp's modules one after the other. power: at full utilisation, `[n_p]` or one for all pixels, in any
    unit that limit is in too. Returns the utilisation and the factor `[...]`, 1 where the limit was kept. Raises LuxloopError for a limit
    below zero.
    """
    if not isinstance(limit, Tensor) and limit < 0:
        raise LuxloopError(f"a power limit of {limit:g} is below zero: give what the lamp may take")
    total = (u * power).sum(-1)
    factor = torch.where(total > limit, limit / torch.where(total > 0, total, 1.0), 1.0)
    return u * factor[..., None], factor


def pixel_flux(headlight: Headlight) -> Tensor:
    """Luminous flux of every pixel at full utilisation in lm, `[n_p]`: a power that all LEDs turn into light alike."""
    y, z = headlight.tangents(headlight.matrix.values.dtype, headlight.matrix.values.device)
    plane = (headlight.left - headlight.right) * (headlight.top - headlight.bottom) / headlight.n_texels
    solid_angle = plane / (1 + y * y + z[:, None] ** 2) ** 1.5
    entries = headlight.matrix.transposed
    flux = entries.values * solid_angle.flatten()[entries.indices.long()]
    return flux.new_zeros(headlight.n_pixels).index_add(0, row_of_entries(entries), flux)
