"""Light that is there without the headlights: an overcast sky and street lamps."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from world.gbuffer import GBuffer
from world.scene import StreetLamp


def ambient_luminance(gbuffer: GBuffer, ambient_lx: float, street_lamps: Sequence[StreetLamp] = ()) -> Tensor:
    """Luminance `[height, width]` in cd/m^2 of Lambertian surfaces; ambient_lx is the illuminance of a surface that faces up.

    A surface sees the share (1 + n_z) / 2 of a uniform sky. Street lamps throw no shadows.
    """
    illuminance = ambient_lx * (1 + gbuffer.normal[2]) / 2
    for lamp in street_lamps:
        away = torch.tensor(lamp.position_m).to(gbuffer.position)[:, None, None] - gbuffer.position
        d2 = (away * away).sum(0)
        illuminance = illuminance + lamp.intensity_cd * (gbuffer.normal * away).sum(0).clamp(min=0) / d2**1.5
    return gbuffer.albedo * illuminance / math.pi
