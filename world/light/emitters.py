"""Lamps at work: what each module emits, where it stands, and the light that arrives on walls and in views."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, direction
from luxloop.world.light.illumination import illuminance, luminance, reach
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.scene.triangles import Triangles


@dataclass(frozen=True, eq=False)
class Source:
    """A module that shines.

    headlight: its grid of texels. texture: `[rows, cols]` cd, or `[3, rows, cols]` linear sRGB in cd, float32.
    T_world_source: `[4, 4]` float64, its headlight frame in the world.
    """

    headlight: Headlight
    texture: Tensor
    T_world_source: Tensor


def sources(lamp: Lamp, utilisations: Sequence[Tensor], T_world_lamp: Tensor, colour: bool = False) -> tuple[Source, ...]:
    """The modules of a lamp that emit anything under utilisations `[n_p]`, one a module."""
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
    where they are, so lamps beside the origin show their parallax. `E = I cos / d^2` (T eq. 2.1.5), float64 on the CPU.
    """
    ray = direction(h_deg, v_deg).flatten(1)
    points = T_world_wall[:3, :3].double() @ (ray / ray[0] * distance_m) + T_world_wall[:3, 3:].double()
    facing = -T_world_wall[:3, :1].double()
    total = torch.zeros(points.shape[1], dtype=torch.float64)
    for source in lit:
        away = source.T_world_source[:3, 3:] - points
        d2 = (away * away).sum(0)
        local = source.T_world_source[:3, :3].T @ -away
        intensity = source.headlight.intensity(source.texture.double().cpu(), local)
        total = total + intensity * ((facing * away).sum(0) / d2.sqrt()).clamp(min=0) / d2
    return total.unflatten(-1, h_deg.shape)


def surface_light(
    gbuffer: GBuffer, lit: Sequence[Source], triangles: Triangles | None = None, extinction_per_m: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Illuminance in lx and luminance in cd/m^2 of what a view sees, `[..., height, width]`, from all sources together.

    Leading dimensions are the textures'. triangles: what may throw shadows. extinction_per_m: of the air that the light
    comes through.
    """
    batch = lit[0].texture.shape[:-2] if lit else ()
    arriving = gbuffer.albedo.new_zeros(*batch, gbuffer.albedo.numel())
    leaving = torch.zeros_like(arriving)
    for source in lit:
        surface = reach(gbuffer, source.headlight, source.T_world_source, triangles)
        light, shine = illuminance(surface, source.texture), luminance(surface, source.texture)
        if extinction_per_m:
            away = gbuffer.position.flatten(1)[:, surface.index] - source.T_world_source[:3, 3:].to(gbuffer.position)
            through = torch.exp(-extinction_per_m * (away * away).sum(0).sqrt())
            light, shine = light * through, shine * through
        arriving[..., surface.index] += light
        leaving[..., surface.index] += shine
    return arriving.unflatten(-1, gbuffer.albedo.shape), leaving.unflatten(-1, gbuffer.albedo.shape)
