"""How right shadows are on roads of each kind, beside a second implementation: `python benchmarks/shadows.py`.

Worlds that stand are looked at as `snowflake` does, at 640 x 480, and from above, 5 to 40 m ahead at 2 cm; those that move from the car on
the road's tiles, with what OpenGL interpolates. Points are drawn at random among those that the lamp would reach if nothing threw a shadow,
and lit as the loop lights them. What is true is said by a ray to each point of exact surfaces, in float64 (`float64_rays`).

leaked: light on points in shadow that are lit nevertheless. lost: light that points in the light do not get. Both are shares of all light
without any shadow. wrong: share of the points that are taken for the other. Points whose pixel an outline crosses are left out; outlines is
their share.
"""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import torch
from bench import Goal, run, show
from float64_rays import hidden
from pydantic import TypeAdapter
from torch import Tensor

from luxloop import Simulation, load, pose_from_degrees
from luxloop.loop.scenario import data
from luxloop.loop.simulation.world import World
from luxloop.world.frames import View, pose
from luxloop.world.light.illumination import illuminance, lit_surface
from luxloop.world.rendering.raycast import TOLERANCE_M, depths, first_hits, sees
from luxloop.world.rendering.surfaces import ExactSurfaces, face_source, surface_source
from luxloop.world.roads.base import Road
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.roads.shapes import RoadParams
from luxloop.world.scene.body import Body
from luxloop.world.scene.ground import RoadTiles, road_mesh
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Triangles

DRIVEN_M = (0.0, 11.3, 23.9)  # where the car is that drives
ABOVE_M, CELL_M = 300.0, 0.02
Place = tuple[Triangles, View, Tensor, bool]  # seen in this view; pose of the lamp; whether the world moves


def roads(given: Namespace) -> Iterator[tuple[str, str, Road]]:
    """Name, name of its kind, and the road itself."""
    for name, table in given.shapes.items():
        yield name, name, TypeAdapter(RoadParams).validate_python(table)
    rng = np.random.default_rng(14)
    for name, part in given.scans.items():
        for u_m in [None, *np.round(rng.uniform(*part, given.places), 2).tolist()]:
            yield f"{name} at {u_m or 'its middle'}", name, OpenCrgRoad(file=str(data.locate(name)), u_m=u_m)


def from_above() -> View:
    """5 to 40 m ahead, 5 m to both sides, from so high that all is seen from above."""
    down = torch.tensor([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]], dtype=torch.float64)
    eye = torch.tensor([22.5, 0.0, ABOVE_M], dtype=torch.float64)
    return View(round(10 / CELL_M), round(35 / CELL_M), ABOVE_M / CELL_M, ABOVE_M / CELL_M, 5 / CELL_M, 17.5 / CELL_M, pose(eye, down))


def outlined(triangles: Triangles, view: View, lamp_m: Tensor, pixels: Tensor) -> Tensor:
    """Which pixels `[N]` an outline of a shadow crosses, `[N]` bool: their corners are not all alike."""
    row, column = pixels // view.width, pixels % view.width
    T, dark = view.T_world_view, []
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        x, y = (column + right - view.cx) / view.fx, (row + down - view.cy) / view.fy
        rays = T[:3, :3] @ torch.stack([x, y, torch.ones_like(x)]).double()
        face = first_hits(triangles, view.origin, rays)
        depth = depths(triangles, face, view.origin, rays)
        dark.append(~sees(triangles, lamp_m, view.origin[:, None] + rays * torch.where(face >= 0, depth, 1.0)))
    return torch.stack(dark).any(0) != torch.stack(dark).all(0)


def shares(place: Place, world: World, n: int) -> dict[str, float]:
    """Shares of one view, true by exact surfaces and found by those of the loop."""
    triangles, view, T_world_lamp, moves = place
    lamp, n_pixels = world.modules[0].headlight, view.width * view.height
    true = ExactSurfaces(face_source("raycast")).gbuffer(triangles, view)
    found = surface_source(world.source, moving=moves).gbuffer(triangles, view)
    reached, lit = lit_surface(true, lamp, T_world_lamp), lit_surface(found, lamp, T_world_lamp, triangles)
    texture = lamp.light_texture(torch.ones(lamp.n_pixels))
    light = torch.zeros(n_pixels).index_put((reached.index,), illuminance(reached, texture))
    is_lit = torch.zeros(n_pixels, dtype=torch.bool).index_fill(0, lit.index, True)
    pixels = reached.index[torch.randperm(len(reached.index), generator=torch.Generator().manual_seed(14))[:n]]
    points = true.position.flatten(1)[:, pixels]
    dark = hidden(triangles, lamp.view(T_world_lamp, 1, 1), points, TOLERANCE_M)
    crossed = outlined(triangles, view, T_world_lamp[:3, 3].double(), pixels)
    light, is_lit, all_light = light[pixels], is_lit[pixels], float(light[pixels].sum())
    leaked, lost = dark & is_lit & ~crossed, ~dark & ~is_lit & ~crossed
    return {
        "in shadow": float(dark.float().mean()),
        "leaked": float(light[leaked].sum()) / all_light,
        "lost": float(light[lost].sum()) / all_light,
        "wrong": float((leaked | lost).float().mean()),
        "outlines": float(crossed.float().mean()),
    }


def places(road: Road, world: World) -> Iterator[tuple[str, str, Place]]:
    """Way and view of a car that stands on a road and of one that drives there."""
    T_world_lamp, standing = world.modules[0].T_body_headlight, Scene((Body("road", road_mesh(road), smooth=True, ground=True),)).at(0.0)
    yield "standing", "camera", (standing, world.view, T_world_lamp, False)
    yield "standing", "above", (standing, from_above(), T_world_lamp, False)
    tiles = RoadTiles(road, 0.2, None, (0.0, 0.0))
    for x_m in DRIVEN_M:
        T_world_body = pose_from_degrees((x_m, 0.0, float(road.z(x_m, 0.0))))
        view = replace(world.view, T_world_view=T_world_body @ world.view.T_world_view)
        triangles = Scene((tiles,)).at(0.0, T_world_body)  # type: ignore[arg-type]
        yield "moving", f"{x_m} m", (triangles, view, T_world_body @ T_world_lamp, True)


def measure(given: Namespace) -> dict[str, Any]:
    world = Simulation.prepare(load("snowflake", ("camera.width_px=640", "camera.height_px=480", "camera.oversampling=1"))).world
    found = [
        {"road": name, "kind": kind, "way": way, "view": view, **shares(place, world, given.points)}
        for name, kind, road in roads(given)
        for way, view, place in places(road, world)
    ]
    by = pd.DataFrame(found).groupby(["kind", "way"], sort=False)
    percent = 100 * by.agg({"in shadow": "mean", "outlines": "mean", "leaked": "max", "lost": "max", "wrong": "max"})
    rows = {kind: {way: percent.loc[kind, way].to_dict() for way in percent.loc[kind].index} for kind in percent.index.unique("kind")}
    show("Standing and moving worlds, %; means of what is in shadow and of outlines, the worst of the others", rows)
    limits = (("standing", "leaked", 0.1), ("standing", "wrong", 0.5), ("moving", "leaked", 1.0))
    worst = 100 * by[["leaked", "wrong"]].max().groupby("way").max()
    return {"results": found, "goals": [Goal(f"{key}, {way}, %", float(worst.loc[way, key]), limit) for way, key, limit in limits]}


if __name__ == "__main__":
    run(measure, __doc__, "points")
