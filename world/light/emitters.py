"""Light sources and their light in views and on walls: headlamp modules, overcast sky, street lamps, lamps of other road users."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from luxloop.world.frames import unit
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, direction
from luxloop.world.light.illumination import illuminance, lit_surface, luminance, luminance_factors, lux_per_cd
from luxloop.world.rendering.gbuffer import GBuffer, Haze
from luxloop.world.rendering.raycast import sees
from luxloop.world.scene.body import Spotlight
from luxloop.world.scene.scene import SUN_M, StreetLamp, SunParams
from luxloop.world.scene.triangles import Triangles

GLOSS_LX: Final = 1e-6  # below which a spotlight has no gloss


def ambient_luminance(
    gbuffer: GBuffer,
    ambient_lx: float,
    street_lamps: Sequence[StreetLamp] = (),
    spotlights: Sequence[Spotlight] = (),
    glossy: bool = False,
) -> Tensor:
    """Luminance `[height, width]` in cd/m^2 of Lambertian surfaces in ambient light, plus that of luminous ones, and of the air.

    glossy: whether surfaces also have the gloss and retroreflection of their materials in the light of street lamps and spotlights.

    ambient_lx: illuminance of a surface that faces up, also in fog; others see the share (1 + n_z) / 2 of a uniform sky. Street lamps and
    spotlights (of the world, `[3]` vectors) throw no shadows and do not light the air.
    """
    albedo = gbuffer.albedo.flatten()
    there = torch.nonzero(albedo)[:, 0]  # the M pixels that reflect
    position, normal = (each.flatten(1).index_select(1, there) for each in (gbuffer.position, gbuffer.normal))  # [3, M]
    illuminance, haze = ambient_lx * (1 + normal[2]) / 2, gbuffer.haze
    for lamp in street_lamps:
        away = torch.tensor(lamp.position_m).to(position)[:, None] - position
        factor = _lux_per_cd(away, normal, haze)
        illuminance = illuminance + lamp.intensity_cd * (_gloss(gbuffer, there, away) * factor if glossy else factor)
    for spot in spotlights:
        away = spot.position.to(position)[:, None] - position
        factor = _lux_per_cd(away, normal, haze)
        lit = torch.nonzero(factor)[:, 0]  # what faces the lamp
        away = away.index_select(1, lit)
        lux = spot_intensity(spot, -away) * factor[lit]
        if glossy:
            strong = torch.nonzero(lux > GLOSS_LX)[:, 0]
            lux[strong] *= _gloss(gbuffer, there[lit[strong]], away[:, strong])
        illuminance.index_add_(0, lit, lux)
    reflected = albedo[there] * illuminance / math.pi
    luminance = torch.zeros_like(albedo).index_copy(0, there, reflected).view_as(gbuffer.albedo)
    if gbuffer.finish is not None:
        own = torch.tensor([each.luminance_cd_m2 for each in gbuffer.finish.materials]).to(luminance)
        luminance = luminance + own[gbuffer.finish.material]
    if haze is None:
        return luminance
    return haze.transmittance * luminance + (1 - haze.transmittance) * haze.medium.horizon(ambient_lx)


def _gloss(gbuffer: GBuffer, index: Tensor, away: Tensor) -> Tensor:
    """Luminance of pixels at flat index `[M]`, lit from `away` `[3, M]` m, as a multiple of that of a matt surface of their albedo."""
    return luminance_factors(gbuffer, index, away) / gbuffer.albedo.flatten()[index]


def sun_luminance(gbuffer: GBuffer, sun: SunParams, triangles: Triangles | None = None, eye: Tensor | None = None) -> Tensor:
    """Luminance `[height, width]` in cd/m^2 of surfaces in the light of the sun, glossy ones too.

    triangles: of bodies that cast shadows, None: none. eye: `[3]` m, about which shadows are parallel; default: the world's origin.
    """
    position, normal = gbuffer.position.flatten(1), gbuffer.normal.flatten(1)
    direction = sun.direction.to(position)
    cosine = (direction @ normal).clamp(min=0)
    lit = torch.nonzero((gbuffer.object_id.flatten() >= 0) & (cosine > 0))[:, 0]
    if triangles is not None:
        place = SUN_M * sun.direction + (0.0 if eye is None else eye.double().cpu())
        lit = lit[sees(triangles, place, position.index_select(1, lit))]
    factor = luminance_factors(gbuffer, lit, direction[:, None].expand(3, len(lit)))
    if gbuffer.haze is not None:
        factor = factor * gbuffer.haze.transmittance.flatten()[lit]
    reflected = factor * cosine[lit] * (sun.illuminance_lx / math.pi)
    return torch.zeros_like(cosine).index_copy(0, lit, reflected).view_as(gbuffer.albedo)


def _lux_per_cd(away: Tensor, normal: Tensor, haze: Haze | None) -> Tensor:
    """As `lux_per_cd`, through the air."""
    clear = lux_per_cd(away, normal)
    return clear if haze is None else clear * haze.medium.transmittance(away)


def spot_intensity(spot: Spotlight, ray: Tensor) -> Tensor:
    """Intensity `[N]` in cd along rays `[3, N]` of any length."""
    x = spot.axis.to(ray)
    y = unit(torch.linalg.cross(torch.tensor([0.0, 0.0, 1.0]).to(ray), x))
    ahead, left, up = torch.stack([x, y, torch.linalg.cross(x, y)]) @ ray
    angles = torch.rad2deg(torch.stack([torch.atan2(left, ahead), torch.atan2(up, torch.hypot(ahead, left))]))
    widths = torch.tensor(spot.width_deg).to(ray)[:, None]
    return spot.intensity_cd * torch.exp(-0.5 * (angles / widths).square().sum(0))


@dataclass(frozen=True, eq=False)
class Source:
    """A module that emits light.

    headlight: its grid of texels. texture: `[rows, cols]` cd, or `[3, rows, cols]` linear sRGB in cd, float32.
    T_world_source: `[4, 4]` float64, its headlight frame in the world.
    """

    headlight: Headlight
    texture: Tensor
    T_world_source: Tensor


def sources(lamp: Lamp, utilisations: Sequence[Tensor], T_world_lamp: Tensor, colour: bool = False) -> tuple[Source, ...]:
    """The modules of a lamp that emit light, for one utilisation `[n_p]` a module."""
    return tuple(
        Source(
            module.headlight,
            module.headlight.colour_texture(u) if colour else module.headlight.light_texture(u),
            T_world_lamp.double().cpu() @ module.T_lamp_module,
        )
        for module, u in zip(lamp.modules, utilisations, strict=True)
        if bool(u.any())
    )


def wall_illuminance(lit: Sequence[Source], T_world_wall: Tensor, h_deg: Tensor, v_deg: Tensor, distance_m: float = 25.0) -> Tensor:
    """Illuminance `[..., *shape]` in lx of a wall that stands perpendicular to the x axis of `T_world_wall`, `distance_m` from its origin.

    h_deg, v_deg: of one shape, angles of the wall's points seen from that origin, to the right and up (type A). The modules light it from
    where they are, so lamps beside the origin show their parallax. Float64 on the CPU.
    """
    ray = direction(h_deg, v_deg).flatten(1)
    points = T_world_wall[:3, :3].double() @ (ray / ray[0] * distance_m) + T_world_wall[:3, 3:].double()
    facing = -T_world_wall[:3, :1].double()
    total = torch.zeros(points.shape[1], dtype=torch.float64)
    for source in lit:
        away = source.T_world_source[:3, 3:] - points
        intensity = source.headlight.intensity(source.texture.double().cpu(), source.T_world_source[:3, :3].T @ -away)
        total += intensity * lux_per_cd(away, facing)
    return total.unflatten(-1, h_deg.shape)


def surface_light(gbuffer: GBuffer, lit: Sequence[Source], triangles: Triangles | None = None) -> tuple[Tensor, Tensor]:
    """Illuminance in lx and luminance in cd/m^2, `[..., height, width]`, of a view's surfaces from all sources together.

    Leading dimensions are the textures'. triangles: of bodies that cast shadows.
    """
    batch = lit[0].texture.shape[:-2] if lit else ()
    arriving = gbuffer.albedo.new_zeros(*batch, gbuffer.albedo.numel())
    leaving = torch.zeros_like(arriving)
    for source in lit:
        surface = lit_surface(gbuffer, source.headlight, source.T_world_source, triangles)
        arriving[..., surface.index] += illuminance(surface, source.texture)
        leaving[..., surface.index] += luminance(surface, source.texture)
    return arriving.unflatten(-1, gbuffer.albedo.shape), leaving.unflatten(-1, gbuffer.albedo.shape)
