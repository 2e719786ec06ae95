"""Patches of a road lie on it, leave no gaps, and are there wherever the vehicle looks."""

import numpy as np
import pytest

from luxloop.world.frames import pose_from_degrees
from luxloop.world.roads.shapes import Flat, Iso8608
from luxloop.world.scene.ground import PATCH_NEAR_M, SIDE_M, SKIRT_M, RoadPatches

ROAD = Iso8608(roughness_class="C")


def patches(road=ROAD) -> RoadPatches:
    return RoadPatches(road, 0.2, None)


def vertices(placed) -> np.ndarray:
    return np.asarray(placed.body.mesh.vertices)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 200.0])
def test_the_road_is_there_ahead_wherever_the_vehicle_heads(yaw_deg: float) -> None:
    T = pose_from_degrees((300.0, -70.0, 0.0), yaw_deg=yaw_deg)
    corners = {tuple(vertices(each)[:, :2].min(0).round(6)) for each in patches(Flat()).near(0, T)}
    for ahead, left in np.random.default_rng(0).uniform((0, -30), (80, 30), (200, 2)):
        x, y = (T[:2, :2].numpy() @ [ahead, left]) + [300.0, -70.0]
        assert (SIDE_M * np.floor(x / SIDE_M), SIDE_M * np.floor(y / SIDE_M)) in corners


def test_they_lie_on_the_road_finer_where_it_is_near_and_with_skirts() -> None:
    T = pose_from_degrees((100.0, 40.0, 0.0), yaw_deg=45.0)
    for each in patches().near(0, T):
        x, y, z = vertices(each).T
        below = ROAD.z(x, y) - z
        assert np.isin(below.round(9), (0.0, SKIRT_M)).all()
        away = np.hypot(*np.clip(np.abs(vertices(each)[:, :2].mean(0) - (100, 40)) - SIDE_M / 2, 0, None))
        assert (len(x) > 1000) == (away <= PATCH_NEAR_M)


def test_a_patch_is_made_once_and_its_normals_look_beyond_it() -> None:
    road = patches()
    first, later = ({id(each) for each in road.near(0, pose_from_degrees((x, 0.0, 0.0)))} for x in (0.5, 1.0))
    assert len(first & later) > 0.9 * len(first)
    patch = next(each for each in road.near(0, pose_from_degrees((60.0, 0.0, 0.0))) if len(vertices(each)) > 1000)
    x, y, _ = vertices(patch).T
    h = 0.2  # its spacing
    normals = np.asarray(patch.body.mesh.vertex_normals)
    slope = (ROAD.z(x + h, y) - ROAD.z(x - h, y)) / (2 * h)
    assert np.abs(-normals[:, 0] / normals[:, 2] - slope).max() < 1e-9
