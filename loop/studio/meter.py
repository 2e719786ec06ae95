"""Light where rays of sight meet the true scene, or a wall ahead of the lamps, by the functions that light the simulation."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from luxloop.loop.report.picture import WALL_M
from luxloop.loop.simulation.lamps import T_world_reference
from luxloop.loop.studio.messages import AskMeter
from luxloop.loop.studio.runs import Run, matrix
from luxloop.loop.studio.snapshot import bodies_at
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import inverse, transform
from luxloop.world.headlight.lamp import direction
from luxloop.world.light.emitters import Source, ambient_luminance, sun_luminance, surface_light, wall_illuminance
from luxloop.world.rendering.gbuffer import along
from luxloop.world.rendering.raycast import first_hits

Columns = dict[str, Sequence[Any]]  # by field of a reading, an item a ray


def readings(run: Run, ask: AskMeter) -> dict[str, Any]:
    """Answer to a request: a reading of each ray, None where it meets nothing.

    Raises LuxloopError if the step's light is not stored, and for a side without a lamp.
    """
    shown = run.lit_snapshot(ask.step)
    head, sources = shown.head, run.sources(shown)
    T_world_body = matrix(head["T_world_body"])
    headlight = run.simulation.scenario.headlight
    sides = [each for each in headlight.lamps if ask.side in (None, each)]
    if not sides:
        raise LuxloopError(f"side: this car has no {ask.side} lamp; give the other one, or null for all lamps")
    eye = torch.tensor(ask.eye_m, dtype=torch.float64)
    rays = torch.tensor(ask.through_m, dtype=torch.float64).T - eye[:, None]  # [3, n]
    T_lamp_world = inverse(T_world_body @ T_world_reference(sides, headlight))
    if ask.on == "wall":
        points, columns = _on_wall(T_lamp_world, eye, rays, [*sources.values()])
    else:
        points, columns = _on_scene(run, head, eye, rays, [*sources.values()])
    x, y, z = transform(T_lamp_world, points)
    h, v = torch.rad2deg(-torch.atan2(y, x)), torch.rad2deg(torch.atan2(z, torch.hypot(x, y)))
    towards = T_world_body[:3, :3] @ direction(h, v)
    cd = torch.zeros_like(h)
    for source in (source for k, source in sources.items() if run.simulation.modules[k].side in sides):
        cd += source.headlight.intensity(source.texture, source.T_world_source[:3, :3].T @ towards)
    columns |= {
        "point_m": points.T.tolist(),
        "ground_m": transform(inverse(matrix(head["T_world_ground"])), points).T.tolist(),
        "h_deg": h.tolist(),
        "v_deg": v.tolist(),
        "distance_m": torch.stack([x, y, z]).norm(dim=0).tolist(),
        "cd": cd.tolist(),
    }
    found = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    return {"type": "meter", "run": ask.run, "step": shown.step, "readings": [each if each["surface"] else None for each in found]}


def _on_scene(run: Run, head: dict[str, Any], eye: Tensor, rays: Tensor, sources: Sequence[Source]) -> tuple[Tensor, Columns]:
    """Points `[3, n]` in the world on the first surface of each ray, and the light there."""
    world, time_s = run.simulation.truth, head["time_s"]
    triangles = bodies_at(run.simulation, time_s, run.bodies)
    surfaces = along(triangles, eye, rays[:, None], first_hits(triangles, eye, rays)[None])
    n = rays.shape[1]
    twice = surfaces.at(torch.arange(n).repeat(2))  # as they are, and upright, facing the car
    twice.normal[:, :, n:] = -matrix(head["T_world_body"])[:3, :1, None].float()
    (lx,), (cd_m2,) = surface_light(twice, sources, triangles)
    if world is not None:
        scene = world.scene
        cd_m2 += ambient_luminance(twice, scene.ambient_lx, scene.street_lamps, scene.spotlights_at(time_s))[0]
        if scene.sun is not None:
            cd_m2 += sun_luminance(twice, scene.sun, triangles, eye)[0]
    return surfaces.position[:, 0].double(), {
        "surface": ["" if world is None else world.instances[number + 1] for number in surfaces.object_id[0].tolist()],
        "normal": surfaces.normal[:, 0].T.tolist(),
        "lx": lx[:n].tolist(),
        "vertical_lx": lx[n:].tolist(),
        "cd_m2": cd_m2[:n].tolist(),
    }


def _on_wall(T_lamp_world: Tensor, eye: Tensor, rays: Tensor, sources: Sequence[Source]) -> tuple[Tensor, Columns]:
    """Points `[3, n]` in the world on a wall 25 m ahead, across the lamp's axis, and its illuminance; nothing shades it."""
    T_world_lamp = inverse(T_lamp_world)
    start, way = transform(T_lamp_world, eye[:, None]), T_lamp_world[:3, :3] @ rays
    share = (WALL_M - start[0]) / way[0]
    there = start + way * share
    x, y, z = there
    h, v = torch.rad2deg(-torch.atan2(y, x)), torch.rad2deg(torch.atan2(z, torch.hypot(x, y)))
    lx = wall_illuminance(sources, T_world_lamp, h, v, WALL_M).tolist()
    return transform(T_world_lamp, there), {
        "surface": ["wall" if each else "" for each in (there.isfinite().all(0) & (share > 0)).tolist()],
        "normal": [(-T_world_lamp[:3, 0]).tolist()] * len(lx),
        "lx": lx,
        "vertical_lx": lx,
        "cd_m2": [None] * len(lx),
    }
