"""What a lamp or an eye has in sight, against a second implementation and against geometry."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from benchmarks.float64_rays import hidden
from luxloop.world.frames import pose_from_degrees
from luxloop.world.rendering.gbuffer import gbuffer
from luxloop.world.rendering.raycast import TOLERANCE_M, sees
from luxloop.world.rendering.surfaces import face_source
from luxloop.world.roads.shapes import Bumps, Flat, Grade, Iso8608
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.ground import road_mesh
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Triangles
from luxloop.world.texels import TexelGrid
from luxloop.world.traffic.objects import BoxParams
from tests.world.grids import bumpy, camera, flat, grid, lamp

LAMP = lamp()
# as wide as lamps of which the road is in the light from 5 m on
WIDE = TexelGrid.from_degrees(1, 1, 20, -20, -10, 5).view(pose_from_degrees((0, 0.6, 0.75)), 1024, 664)
DISTANCES_M = (5, 10, 20, 40, 60)


def scene_with(road: trimesh.Trimesh, *bodies: Body) -> Triangles:
    return Scene((Body("road", road, smooth=True, ground=True), *bodies)).at(0.0)


def box(x_m: float, height_m: float = 1.0, y_m: float = 0.6) -> Body:
    return BoxParams(name="box", size_m=(1, 1, height_m), track=[{"position_m": (x_m, y_m, 0)}]).build()


def on_road(x, y) -> torch.Tensor:
    x, y = torch.broadcast_tensors(torch.as_tensor(x, dtype=torch.float32), torch.as_tensor(y, dtype=torch.float32))
    return torch.stack([x, y, torch.zeros_like(x)])


def lit(triangles: Triangles, points: torch.Tensor) -> torch.Tensor:
    return sees(triangles, LAMP.origin, points)


def test_a_flat_road_casts_no_shadow_on_itself():
    points = on_road(torch.linspace(3, 65, 200_000), torch.linspace(-0.9, 2.1, 200_000))
    assert lit(scene_with(flat()), points).all()


def rough() -> trimesh.Trimesh:
    rng = np.random.default_rng(0)
    return grid(lambda x, y: rng.normal(0, 0.002, x.shape), np.linspace(-5, 70, 700), np.linspace(-5, 5, 100))


def things() -> tuple[Body, ...]:
    sheet = replace(box(0.0), name="sheet", two_sided=True, track=PoseTrack.static(pose_from_degrees((20.0, -0.5, 0.3), yaw_deg=70)))
    return box(14.0, 0.4), sheet


@pytest.mark.parametrize(
    "mesh", [rough(), bumpy(), road_mesh(Iso8608(roughness_class="E"))], ids=["white noise of 2 mm", "bumpy", "class E"]
)
def test_shadows_are_those_of_a_second_implementation_in_float64(mesh):
    triangles, view = scene_with(mesh, *things()), camera()
    seen = gbuffer(triangles, view, face_source().face_ids(triangles, view))
    points = seen.position[:, seen.object_id >= 0]
    image, depth = LAMP.project(points)
    points = points[:, (image > 0).all(0) & (image[0] < LAMP.width) & (image[1] < LAMP.height) & (depth > 0.5)]
    dark = hidden(triangles, LAMP, points, TOLERANCE_M)
    assert 0.01 < dark.double().mean() < 0.6 and len(dark) > 5000
    # embree finds faces in float32: a ray that grazes a crest within a micrometre may take the other side
    assert (dark == lit(triangles, points)).sum() <= 2


def mesh_points(mesh: trimesh.Trimesh, x_m: float, n: int = 10_000) -> torch.Tensor:
    """Points `[3, N]` float64 on a road's faces about x_m ahead that the wide lamp may light."""
    rng = np.random.default_rng(1)
    centre = mesh.triangles_center
    face = rng.choice(np.flatnonzero((abs(centre[:, 0] - x_m) < 0.3 + 0.06 * x_m) & (abs(centre[:, 1] - 0.6) < 0.3 * x_m)), n)
    points = torch.from_numpy(np.einsum("nk,nki->in", rng.dirichlet([1, 1, 1], n), mesh.triangles[face]))
    away = WIDE.origin[:, None] - points
    normals = torch.from_numpy(mesh.face_normals[face].T.copy())
    image, _ = WIDE.project(points)
    facing = (image > 0).all(0) & (image[0] < WIDE.width) & (image[1] < WIDE.height) & ((normals * away).sum(0) > 0)
    return points[:, facing]


@pytest.mark.parametrize(
    "road",
    [Flat(), Grade(grade_percent=12, crossfall_percent=5, start_x_m=3), Bumps(), Iso8608(roughness_class="C")],
    ids=["flat", "steep", "bumps", "rough"],
)
def test_no_road_throws_shadows_that_are_not_there(road):
    mesh = road_mesh(road)
    triangles, seen = scene_with(mesh), 0
    for x_m in DISTANCES_M:
        points = mesh_points(mesh, x_m)
        found = sees(triangles, WIDE.origin, points.float())
        dark = points[:, ~found]  # in float32 they may be off by the other half of the tolerance
        assert not dark.numel() or hidden(triangles, WIDE, dark, TOLERANCE_M / 2).all(), x_m
        seen += int(found.sum())
    assert seen > 30_000


@pytest.mark.parametrize("thickness_m", [0.005, 0.02, 1.0], ids=["board", "thin wall", "box"])
@pytest.mark.parametrize("x_m", DISTANCES_M)
@pytest.mark.parametrize("road", [Flat(), Bumps()], ids=["flat", "bumps"])
def test_shadows_begin_at_the_foot_at_all_distances(road, x_m, thickness_m):
    thing = BoxParams(name="thing", size_m=(thickness_m, 1.5, 1.2), track=[{"position_m": (x_m, 0.6, float(road.z(x_m, 0.6)) - 0.2)}])
    triangles = scene_with(road_mesh(road), thing.build())
    back = x_m + thickness_m / 2
    # in the umbra's middle, from right behind on: what is thicker than the tolerance lets nothing through
    x, y = np.meshgrid(back + np.geomspace(1e-3, 2.0, 200), np.linspace(0.2, 1.0, 21))
    behind = torch.from_numpy(np.stack([x, y, road.z(x, y)])).flatten(1).float()
    assert thickness_m > TOLERANCE_M
    assert not sees(triangles, WIDE.origin, behind).any()
    # and its face towards the lamp, to its border, stays lit
    y, z = np.meshgrid(np.linspace(-0.149, 1.349, 60), float(road.z(x_m, 0.6)) + np.linspace(0.1, 0.999, 40))
    face = torch.from_numpy(np.stack([np.full_like(y, x_m - thickness_m / 2), y, z])).flatten(1).float()
    assert sees(triangles, WIDE.origin, face).all()


def test_nothing_behind_a_lamp_is_in_the_way_nor_what_stands_behind_a_point():
    triangles = scene_with(flat(), box(-6.0), box(20.0))
    points = torch.tensor([[19.0, 0.6, 0.1], [30.0, 0.6, 30.0], [0.0, 0.6, 0.0], [25.0, 0.6, 0.0], [-9.0, 0.6, 0.0]]).T
    assert lit(triangles, points).tolist() == [True, True, True, False, False]


def test_points_may_come_in_batches_on_any_device(device):
    points = torch.stack([on_road([16.0, 19.0, 25.0], 0.6), on_road([19.0, 16.0, 10.0], 0.6)])
    seen = lit(scene_with(flat(), box(17.0)), points.to(device))
    assert seen.device == points.to(device).device
    assert seen.tolist() == [[True, False, False], [False, True, True]]


def test_a_road_hides_what_it_hides_as_a_body():
    """Of a body every point is tested against all faces; of the ground, those that a far side could hide, against far sides."""
    road = Body("road", road_mesh(Iso8608(roughness_class="E")), smooth=True)
    as_ground, as_body = (Scene((replace(road, ground=each), *things())).at(0.0) for each in (True, False))
    points = torch.cat([mesh_points(road.mesh, x_m) for x_m in DISTANCES_M], 1)
    found, expected = (sees(each, WIDE.origin, points) for each in (as_ground, as_body))
    assert 0.05 < (~expected).double().mean() < 0.95
    # rounding of embree's float32 at crests, as above
    assert (found != expected).sum() <= 1e-3 * len(expected)
