import math

import numpy as np
import pytest
import torch

from luxloop.world.frames import pose_from_degrees
from luxloop.world.materials.library import RoadSurfaceParams, Texture
from luxloop.world.roads.shapes import Grade
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.scene import Scene
from luxloop.world.traffic.objects import BoxParams, MeshParams
from tests.world.grids import bumpy, flat

ORIGIN = {"position_m": (0.0, 0.0, 0.0)}
TURN = [{"time_s": 1.0, "position_m": (10, 0, 0)}, {"time_s": 2.0, "position_m": (14, 2, 0), "yaw_deg": 90}]


def box(**keys) -> BoxParams:
    return BoxParams(**{"name": "box", "size_m": (1.0, 2.0, 3.0), "track": [ORIGIN], **keys})


def test_track_interpolates_and_holds_its_ends():
    track = box(track=TURN).build().track
    assert torch.allclose(track.pose_at(1.5), pose_from_degrees((12, 1, 0), yaw_deg=45), atol=1e-12)
    assert torch.equal(track.pose_at(-7.0), pose_from_degrees((10, 0, 0)))
    assert torch.equal(track.pose_at(7.0), pose_from_degrees((14, 2, 0), yaw_deg=90))


def test_on_a_road_a_body_keeps_its_height_over_it_all_the_way():
    grade = Grade(grade_percent=5.0, crossfall_percent=2.0, start_x_m=10.0, curve_m=4.0)
    ends = torch.stack([pose_from_degrees((0, 1, 0.5), yaw_deg=30), pose_from_degrees((34, 1, 0.5), yaw_deg=30)])
    plain, track = PoseTrack((0.0, 34.0), ends), PoseTrack((0.0, 34.0), ends, road=grade)
    # Level, then a parabola of 4 m, then 5 %; 2 % to the left from 6 m on. Beyond the last pose it stands, uphill.
    for t_s, height_m in ((0.0, 0.0), (8.0, 0.02), (12.0, 0.02 + 0.05 * 2**2 / 8), (34.0, 0.02 + 0.05 * (2 + 20)), (99.0, 1.12)):
        T = track.pose_at(t_s)
        assert T[2, 3] == pytest.approx(0.5 + height_m, abs=1e-12)
        T[2, 3] = 0.5
        assert torch.allclose(T, plain.pose_at(t_s), rtol=0, atol=1e-12)


def test_a_body_is_there_from_appearing_until_just_before_vanishing():
    track = box(appears_s=1.0, vanishes_s=2.0).build().track
    assert [track.visible_at(t) for t in (0.99, 1.0, 1.99, 2.0)] == [False, True, True, False]


def test_only_what_moved_is_rebuilt():
    scene = Scene((Body("road", flat()), box(track=TURN, vanishes_s=3.0).build()))
    before = scene.at(0.0)
    same, after = scene.at(0.5, before=before), scene.at(1.5, before=before)
    assert scene.key_at(0.0) == scene.key_at(0.5) != scene.key_at(1.5)
    assert before.placed[0] is after.placed[0]
    assert before.placed[1] is same.placed[1] is not after.placed[1]
    assert before.groups[0] is after.groups[0] and before.groups[1] is same.groups[1] is not after.groups[1]  # with embree's copies
    assert [placed.object_id for placed in scene.at(3.0).placed] == [0]


def test_smooth_normals_follow_the_surface_and_flat_ones_the_faces():
    mesh = bumpy()
    x, y, _ = mesh.vertices[mesh.faces].mean(1).T
    slope = np.c_[-0.039 * np.cos(1.3 * x) * np.cos(0.9 * y), 0.027 * np.sin(1.3 * x) * np.sin(0.9 * y), np.ones_like(x)]
    exact = torch.from_numpy(slope / np.linalg.norm(slope, axis=1, keepdims=True))
    inside = torch.from_numpy((abs(x - 22) < 25) & (abs(y) < 7))
    for smooth in (True, False):
        mean = torch.nn.functional.normalize(Body("road", mesh, smooth=smooth).corner_normals.mean(1), dim=-1)
        # the slope turns by 0.053 rad/m along x; a cell is 0.11 x 0.16 m, of which the face's middle is off by a part
        assert ((mean - exact).norm(dim=-1)[inside] < 0.004).all()


def test_an_open_mesh_is_two_sided(tmp_path):
    flat().export(tmp_path / "sheet.obj")
    assert MeshParams(name="sheet", file=tmp_path / "sheet.obj", track=[ORIGIN]).build().two_sided


def test_texture_lies_along_x_and_y_and_repeats():
    texture = Texture(torch.arange(12, dtype=torch.float32).view(4, 3), texel_m=0.5, origin_m=(10.0, -1.0))
    x, y = torch.tensor([10.25, 10.75, 10.25, 12.25, 10.5, 10.0]), torch.tensor([-0.75, -0.75, -0.25, 0.75, -0.75, -0.75])
    assert texture.at(x, y).tolist() == [0.0, 3.0, 1.0, 0.0, 1.5, 4.5]


def test_asphalt_of_a_drive_begins_as_that_of_a_standing_car_and_does_not_repeat():
    params = RoadSurfaceParams(seed=3)
    x, y = (each.flatten() for each in torch.meshgrid(torch.arange(0.1, 35.9, 0.02), torch.arange(-3, 3, 0.02), indexing="ij"))
    standing, driving = params.texture(), params.texture(long=True)
    first, second, third = (driving.at(x.double() + 36 * k, y.double()) for k in range(3))
    assert torch.equal(first, standing.at(x.double(), y.double()))
    assert all(abs(float(torch.corrcoef(torch.stack(pair))[0, 1])) < 0.05 for pair in ((first, second), (second, third), (first, third)))
    assert first.mean().item() == pytest.approx(second.mean().item(), rel=0.03), "the same asphalt, of which there are other patches"


def test_asphalt_has_its_albedo_its_seed_and_its_lines():
    params = RoadSurfaceParams(albedo=0.15, seed=3)
    albedo = params.texture().albedo
    assert math.isclose(albedo.mean(), 0.15, rel_tol=1e-4)
    assert 0.05 < albedo.std() / 0.15 < 0.25
    assert torch.equal(albedo, params.texture().albedo)
    assert not torch.equal(albedo, RoadSurfaceParams(albedo=0.15, seed=4).texture().albedo)
    assert torch.equal(RoadSurfaceParams(grain=0.0).texture().albedo.unique(), torch.tensor([0.2]))
    painted = RoadSurfaceParams(markings=True).texture()
    x = torch.tensor([1.0, 5.0, 1.0, 5.0, 5.0])
    y = torch.tensor([1.75, 1.75, -1.75, -1.75, 0.0])
    assert (painted.at(x, y) > 0.4).tolist() == [True, False, True, True, False]
