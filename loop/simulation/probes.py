"""Probes: luxmeters at places of the world, of the car or of an object."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.scenario.probes import ProbeParams
from luxloop.loop.simulation.world import LitScene, World
from luxloop.perception.eye import veil_per_lux
from luxloop.world.frames import transform, unit
from luxloop.world.headlight.lamp import REST, Commands
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.rendering.raycast import TOLERANCE_M, sees

INSIDE_M: Final = 1.5  # in front of an object's probe, which may lie in the object, such as a driver's eye


def illuminance_at(
    probes: Mapping[str, ProbeParams], world: World, time_s: float, lights: Sequence[Utilisation], commands: Commands = ()
) -> dict[str, float]:
    """Illuminance in lx from the lamps on each probe; NaN while its object does not exist."""
    lit = world.lit(time_s)
    arriving = {name: _arriving(probe, world, lit, lights, commands) for name, probe in probes.items()}
    return {name: math.nan if light is None else sum(lx for lx, _ in light) for name, light in arriving.items()}


def veils_at(
    probes: Mapping[str, ProbeParams], world: World, time_s: float, lights: Sequence[Utilisation], commands: Commands, age_years: float
) -> dict[str, float]:
    """Veiling luminance in cd/m^2 by the lamps in an eye at each probe that looks along `facing`; NaN while its object does not exist."""
    lit, found = world.lit(time_s), dict[str, float]()
    for name, probe in probes.items():
        if (light := _arriving(probe, world, lit, lights, commands)) is None:
            found[name] = math.nan
            continue
        lx, cos = torch.tensor([(0.0, 1.0), *light], dtype=torch.float64).T
        found[name] = float(lx @ veil_per_lux(torch.rad2deg(cos.clamp(max=1).acos()), age_years))
    return found


def _arriving(
    probe: ProbeParams, world: World, lit: LitScene, lights: Sequence[Utilisation], commands: Commands
) -> list[tuple[float, float]] | None:
    """Illuminance in lx from each module that shines on a probe, and the cosine of its angle; None while its object does not exist."""
    T_world_frame = _frame(probe, world, lit.time_s)
    if T_world_frame is None:
        return None
    place = transform(T_world_frame, torch.tensor(probe.position_m, dtype=torch.float64)[:, None])
    normal = None if probe.facing is None else unit(T_world_frame[:3, :3] @ torch.tensor(probe.facing, dtype=torch.float64)[:, None])
    found = list[tuple[float, float]]()
    for module, light, command in zip(lit.modules, lights, commands or (REST,) * len(lit.modules), strict=True):
        if not bool(light.u.any()):
            continue
        T_world_headlight = lit.vehicle.T_world_body @ command.turn(module.T_body_headlight).double().cpu()
        away = T_world_headlight[:3, 3:] - place
        per_cd = float(lux_per_cd(away, normal))
        near = TOLERANCE_M if probe.frame in ("world", "car") else INSIDE_M
        if per_cd and bool(sees(lit.triangles, T_world_headlight[:3, 3], place, near)):
            texture = module.textures.light_texture(light.u).cpu()
            ray = T_world_headlight[:3, :3].T @ -away
            lx = command.intensity * float(module.headlight.intensity(texture, ray)) * per_cd
            found.append((lx, per_cd / float(lux_per_cd(away))))
    return found


def _frame(probe: ProbeParams, world: World, time_s: float) -> Tensor | None:
    """`T_world_frame` `[4, 4]` of a probe, None while its object does not exist."""
    if probe.frame == "world":
        return torch.eye(4, dtype=torch.float64)
    if probe.frame == "car":
        return world.motion.at(time_s).T_world_body
    track = next(each.track for each in world.scene.objects if each.name == probe.frame)
    return track.pose_at(time_s) if track.visible_at(time_s) else None
