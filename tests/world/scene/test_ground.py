"""Roads in tiles and in patches: they lie on the road and meet, are fine where it is near, and are there where the vehicle looks."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from luxloop.world.frames import pose_from_degrees
from luxloop.world.rendering.deferred import DeferredRenderer
from luxloop.world.rendering.rasterise import NoOpenGL
from luxloop.world.rendering.surfaces import QuickSurfaces
from luxloop.world.roads.base import Road
from luxloop.world.roads.shapes import Flat, Iso8608
from luxloop.world.scene.ground import LENGTH_M, NEAR_M, PATCH_NEAR_M, SIDE_M, SIGHT_M, SKIRT_M, RoadPatches, RoadTiles
from luxloop.world.scene.triangles import Instance, Triangles
from tests.world.grids import camera

ROAD = Iso8608(roughness_class="C")


def tiles(road: Road = ROAD) -> RoadTiles:
    return RoadTiles(road, 0.2, None, (0.0, 0.0))


def near(road: RoadTiles | RoadPatches, T_world_ground: torch.Tensor) -> tuple[Instance, ...]:
    return road.near(0, T_world_ground)


def vertices(placed) -> np.ndarray:
    return np.asarray(placed.body.mesh.vertices)


def test_tiles_lie_on_the_road_and_meet():
    close = near(tiles(), pose_from_degrees((50.0, 0.0, 0.0)))
    for tile in close:
        x, y, z = vertices(tile).T
        assert np.array_equal(z, ROAD.z(x, y))
    for before, after in pairwise(close):
        border = vertices(before)[:, 0].max()
        ends = [corners[corners[:, 0] == border] for corners in (vertices(before), vertices(after))]
        assert len(ends[0]) > 50 and np.array_equal(*ends)  # the same vertices, near and far


def test_tiles_are_there_where_the_vehicle_looks_and_finer_where_it_is_near():
    close = near(tiles(), pose_from_degrees((50.0, 0.0, 0.0)))
    starts = [vertices(tile)[:, 0].min() for tile in close]
    assert min(starts) > 50 - LENGTH_M and max(starts) > 50 + SIGHT_M - LENGTH_M
    fine = [tile.n_faces for tile, start in zip(close, starts, strict=True) if start < 50 + NEAR_M]
    assert min(fine) > 4 * max(tile.n_faces for tile, start in zip(close, starts, strict=True) if start > 50 + NEAR_M)
    back = near(tiles(), pose_from_degrees((50.0, 0.0, 0.0), yaw_deg=180))
    assert max(vertices(tile)[:, 0].max() for tile in back) < 50 + LENGTH_M


def test_normals_look_beyond_the_tile():
    tile = near(tiles(), pose_from_degrees((20.0, 0.0, 0.0)))[0]
    x, y, _ = vertices(tile).T
    inner = np.abs(y) < 3
    h = 0.1
    slope = (ROAD.z(x + h, y) - ROAD.z(x - h, y)) / (2 * h)
    normals = np.asarray(tile.body.mesh.vertex_normals)
    # central differences over the mesh's own spacing, at the borders as inside
    assert np.abs(-normals[:, 0] / normals[:, 2] - slope)[inner].max() < 1e-6
    assert np.ptp(slope) > 0.05


def test_the_road_has_no_holes():
    try:
        renderer = QuickSurfaces(DeferredRenderer())
    except NoOpenGL as error:
        pytest.skip(str(error))
    view = camera()
    placed = near(tiles(), pose_from_degrees((0.0, 0.0, 0.0)))
    seen = renderer.gbuffer(Triangles.of(*placed), view)
    rays = view.rays()
    depth = -view.origin[2] / rays[2]
    ground = view.origin[:, None, None] + depth * rays
    # well within the sight, so that the last bumps hide nothing behind them
    expected = (rays[2] < 0) & (ground[0] < SIGHT_M - 40) & (ground[1].abs() < 20)
    assert expected.sum() > 1000 and bool((seen.object_id[expected] == 0).all())
    assert torch.isfinite(seen.position).all()


def patches(road=ROAD) -> RoadPatches:
    return RoadPatches(road, 0.2, None)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 200.0])
def test_the_road_is_there_ahead_wherever_the_vehicle_heads(yaw_deg):
    T = pose_from_degrees((300.0, -70.0, 0.0), yaw_deg=yaw_deg)
    corners = {tuple(vertices(each)[:, :2].min(0).round(6)) for each in near(patches(Flat()), T)}
    for ahead, left in np.random.default_rng(0).uniform((0, -30), (80, 30), (200, 2)):
        x, y = (T[:2, :2].numpy() @ [ahead, left]) + [300.0, -70.0]
        assert (SIDE_M * np.floor(x / SIDE_M), SIDE_M * np.floor(y / SIDE_M)) in corners


def test_they_lie_on_the_road_finer_where_it_is_near_and_with_skirts():
    T = pose_from_degrees((100.0, 40.0, 0.0), yaw_deg=45.0)
    for each in near(patches(), T):
        x, y, z = vertices(each).T
        below = ROAD.z(x, y) - z
        assert np.isin(below.round(9), (0.0, SKIRT_M)).all()
        away = np.hypot(*np.clip(np.abs(vertices(each)[:, :2].mean(0) - (100, 40)) - SIDE_M / 2, 0, None))
        assert (len(x) > 1000) == (away <= PATCH_NEAR_M)
