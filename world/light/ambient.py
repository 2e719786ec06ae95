"""Light that is there without the headlights: an overcast sky, street lamps, lamps of other road users."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from luxloop.world.frames import unit
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.scene.body import Spotlight
from luxloop.world.scene.scene import StreetLamp


def ambient_luminance(
    gbuffer: GBuffer, ambient_lx: float, street_lamps: Sequence[StreetLamp] = (), spotlights: Sequence[Spotlight] = ()
) -> Tensor:
    """Luminance `[height, width]` in cd/m^2: that of Lambertian surfaces, and what some shine with themselves.

    ambient_lx: illuminance of a surface that faces up; others see the share (1 + n_z) / 2 of a uniform sky. Street lamps and spotlights (of
    the world, `[3]` vectors) throw no shadows.
    """
    albedo = gbuffer.albedo.flatten()
    there = torch.nonzero(albedo)[:, 0]  # what reflects, of M pixels
    position, normal = (each.flatten(1).index_select(1, there) for each in (gbuffer.position, gbuffer.normal))  # [3, M]
    illuminance = ambient_lx * (1 + normal[2]) / 2
    for lamp in street_lamps:
        away = torch.tensor(lamp.position_m).to(position)[:, None] - position
        illuminance = illuminance + lamp.intensity_cd * _cos_per_d2(normal, away)
    for spot in spotlights:
        away = spot.position.to(position)[:, None] - position
        factor = _cos_per_d2(normal, away)
        lit = torch.nonzero(factor)[:, 0]  # what faces the lamp
        illuminance.index_add_(0, lit, _intensity(spot, away.index_select(1, lit).neg_()) * factor[lit])
    reflected = albedo[there] * illuminance / math.pi
    luminance = torch.zeros_like(albedo).index_copy(0, there, reflected).view_as(gbuffer.albedo)
    if gbuffer.finish is None:
        return luminance
    own = torch.tensor([each.luminance_cd_m2 for each in gbuffer.finish.materials]).to(luminance)
    return luminance + own[gbuffer.finish.material]


def _cos_per_d2(normal: Tensor, away: Tensor) -> Tensor:
    """`cos / d^2` in 1/m^2 `[M]` of light from `away` `[3, M]` m (T eq. 2.1.5)."""
    d2 = (away * away).sum(0)
    return (normal * away).sum(0).clamp(min=0) / (d2 * d2.sqrt())


def _intensity(spot: Spotlight, ray: Tensor) -> Tensor:
    """Intensity `[N]` in cd along rays `[3, N]` of any length."""
    x = spot.axis.to(ray)
    y = unit(torch.linalg.cross(torch.tensor([0.0, 0.0, 1.0]).to(ray), x))
    ahead, left, up = torch.stack([x, y, torch.linalg.cross(x, y)]) @ ray
    angles = torch.rad2deg(torch.stack([torch.atan2(left, ahead), torch.atan2(up, torch.hypot(ahead, left))]))
    widths = torch.tensor(spot.width_deg).to(ray)[:, None]
    return spot.intensity_cd * torch.exp(-0.5 * (angles / widths).square().sum(0))
