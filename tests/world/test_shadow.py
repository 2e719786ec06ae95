import numpy as np
import pytest
import torch
import trimesh

from tests.world.grids import bumpy, camera, flat, grid, lamp
from world.body import Body
from world.face_source import face_source
from world.frames import pose_from_degrees
from world.gbuffer import gbuffer
from world.objects import BoxParams
from world.raycast import first_hits
from world.roadmesh import road_mesh
from world.roads import Bumps, Flat, Grade, Iso8608, Road
from world.scene import Scene
from world.shadow import BIAS_M, ShadowMap, shadow_map, visible
from world.texels import TexelGrid
from world.triangles import Triangles, depths
from world.view import View

LAMP = lamp()
# as wide as lamps of which the road is in the light from 5 m on, at the loop's resolution
WIDE = TexelGrid.from_degrees(1, 1, 20, -20, -10, 5).view(pose_from_degrees((0, 0.6, 0.75)), 1024, 664)
DISTANCES_M = (5, 10, 20, 40, 60)


def scene_with(road, *boxes: BoxParams) -> Triangles:
    return Scene((Body("road", road, smooth=True), *(box.build() for box in boxes))).at(0.0)


def box(x_m: float, height_m: float = 1.0, y_m: float = 0.6) -> BoxParams:
    return BoxParams(name="box", size_m=(1, 1, height_m), track=[{"position_m": (x_m, y_m, 0)}])


def shadow_of(triangles: Triangles, view: View = LAMP) -> ShadowMap:
    return shadow_map(triangles, view, face_source())


def on_road(x, y) -> torch.Tensor:
    x, y = torch.broadcast_tensors(torch.as_tensor(x, dtype=torch.float32), torch.as_tensor(y, dtype=torch.float32))
    return torch.stack([x, y, torch.zeros_like(x)])


def test_a_flat_road_casts_no_shadow_on_itself():
    points = on_road(torch.linspace(3, 65, 200_000), torch.linspace(-0.9, 2.1, 200_000))
    assert visible(shadow_of(scene_with(flat())), points).all()


def rough() -> object:
    rng = np.random.default_rng(0)
    return grid(lambda x, y: rng.normal(0, 0.002, x.shape), np.linspace(-5, 70, 700), np.linspace(-5, 5, 100))


@pytest.mark.parametrize("road, missed", [(rough(), 0.10), (bumpy(), 0.02)], ids=["rough", "bumpy"])
def test_shadows_on_an_uneven_road_are_those_that_rays_find(road, missed):
    triangles, view = scene_with(road), camera()
    seen = gbuffer(triangles, view, face_source().face_ids(triangles, view))
    points = seen.position[:, seen.object_id >= 0]
    image, _ = LAMP.project(points)
    inside = (image > 0).all(0) & (image[0] < LAMP.width) & (image[1] < LAMP.height) & (points[0] > 5)
    points = points[:, inside]
    rays = points.double() - LAMP.origin[:, None]
    reached = depths(triangles, first_hits(triangles, LAMP.origin, rays), LAMP.origin, rays)
    lit = (1 - reached) * rays.norm(dim=0) < 5e-3
    mapped = visible(shadow_of(triangles), points)
    assert 0.01 < (~lit).double().mean() < 0.5
    assert (lit & ~mapped).double().mean() < 1e-4
    # shadows narrower than a texel are lost: with 2 mm of white noise on a grid of 11 x 10 cm that is many of them
    assert (~lit & mapped).double().mean() < missed


def mesh_points(mesh: trimesh.Trimesh, x_m: float, n: int = 10_000) -> torch.Tensor:
    """Points `[3, N]` float64 on a road's faces about x_m ahead that the wide lamp may light."""
    rng = np.random.default_rng(1)
    centre = mesh.triangles_center
    face = rng.choice(np.flatnonzero((abs(centre[:, 0] - x_m) < 0.3 + 0.06 * x_m) & (abs(centre[:, 1] - 0.6) < 0.3 * x_m)), n)
    points = torch.from_numpy(np.einsum("nk,nki->in", rng.dirichlet([1, 1, 1], n), mesh.triangles[face]))
    away = WIDE.origin[:, None] - points
    normals = torch.from_numpy(mesh.face_normals[face].T.copy())
    image, _ = WIDE.project(points)
    lit = (image > 0).all(0) & (image[0] < WIDE.width) & (image[1] < WIDE.height) & ((normals * away).sum(0) > 0)
    return points[:, lit]


@pytest.mark.parametrize(
    "road, false_share",
    [(Flat(), 0), (Grade(grade_percent=12, crossfall_percent=5, start_x_m=3), 0), (Bumps(), 1e-3), (Iso8608(roughness_class="C"), 1e-3)],
    ids=["flat", "steep", "bumps", "rough"],  # the steep one leaves the field by its upper border
)
def test_no_road_throws_shadows_that_are_not_there(road: Road, false_share: float):
    mesh = road_mesh(road)
    triangles = scene_with(mesh)
    shadow, seen = shadow_of(triangles, WIDE), 0
    for x_m in DISTANCES_M:
        points = mesh_points(mesh, x_m)
        rays = points - WIDE.origin[:, None]
        reached = depths(triangles, first_hits(triangles, WIDE.origin, rays), WIDE.origin, rays)
        lit = (1 - reached) * rays.norm(dim=0) < 5e-3
        assert (~visible(shadow, points.float()) & lit).sum() <= false_share * len(lit), x_m
        seen += len(lit)
    assert seen > 30_000


@pytest.mark.parametrize("thickness_m", [0.02, 1.0], ids=["thin wall", "box"])
@pytest.mark.parametrize("x_m", DISTANCES_M)
@pytest.mark.parametrize("road", [Flat(), Bumps()], ids=["flat", "bumps"])
def test_shadows_begin_at_the_foot_at_all_distances(road: Road, x_m: float, thickness_m: float):
    thing = BoxParams(name="thing", size_m=(thickness_m, 1.5, 1.2), track=[{"position_m": (x_m, 0.6, float(road.z(x_m, 0.6)) - 0.2)}])
    shadow = shadow_of(scene_with(road_mesh(road), thing), WIDE)
    back = x_m + thickness_m / 2
    # in the umbra's middle, from right behind on: a wall thicker than the bias lets nothing through
    x, y = np.meshgrid(back + np.geomspace(1e-3, 2.0, 200), np.linspace(0.2, 1.0, 21))
    behind = torch.from_numpy(np.stack([x, y, road.z(x, y)])).flatten(1).float()
    assert thickness_m > BIAS_M
    assert not visible(shadow, behind).any()
    # and its face towards the lamp, to its border, stays lit
    y, z = np.meshgrid(np.linspace(-0.149, 1.349, 60), float(road.z(x_m, 0.6)) + np.linspace(0.1, 0.999, 40))
    face = torch.from_numpy(np.stack([np.full_like(y, x_m - thickness_m / 2), y, z])).flatten(1).float()
    assert visible(shadow, face).all()


@pytest.mark.parametrize("x_m", [13.0, 17.0, 50.0])
def test_the_shadow_of_a_box_begins_at_its_foot(x_m):
    shadow = shadow_of(scene_with(flat(), box(x_m)))
    y = torch.linspace(0.15, 1.05, 50)
    behind = torch.linspace(x_m + 0.501, x_m + 8, 500)[:, None]
    assert not visible(shadow, on_road(behind, y).flatten(1)).any()
    under = torch.linspace(x_m - 0.45, x_m + 0.5, 100)[:, None]
    # beneath the box, from a few texels behind its front on; a texel of the map covers 0.29 m of road at 50 m
    texel = 1.4 * x_m**2 / (0.75 * LAMP.fy)
    assert not visible(shadow, on_road(under[under[:, 0] > x_m - 0.5 + texel], y).flatten(1)).any()
    before = torch.linspace(10.0, x_m - 0.501, 500)[:, None]
    assert visible(shadow, on_road(before, y).flatten(1)).all()
    side = torch.tensor([0.6 - 0.52, 0.6 + 0.52])
    front = on_road(torch.full((2,), x_m - 0.5), side)
    assert visible(shadow, front).all()
    surface = torch.stack([torch.full((50,), x_m - 0.5), y, torch.linspace(0.0, 0.99, 50)])
    assert visible(shadow, surface).all()


def test_a_low_box_throws_a_shadow_of_the_right_length():
    shadow = shadow_of(scene_with(flat(), box(10.0, height_m=0.3)))
    tip = 10.5 * 0.75 / (0.75 - 0.3)
    x = torch.linspace(10.6, 25, 3000)
    dark = x[~visible(shadow, on_road(x, 0.6))]
    # a texel covers 7 cm of road there
    assert abs(dark.max() - tip) < 0.08
    assert len(dark) == ((x >= dark.min()) & (x <= dark.max())).sum()


def test_beside_the_map_behind_the_lamp_and_in_the_sky_nothing_is_in_shadow():
    shadow = shadow_of(scene_with(flat(), box(6.0)))
    points = torch.tensor([[20.0, 30.0, 0.0], [-5.0, 0.6, 0.7], [30.0, 0.6, 30.0], [60.0, -5.0, 2.0], [0.0, 0.0, 0.0]]).T
    assert visible(shadow, points).all()


def test_points_may_come_in_batches_on_any_device(device):
    shadow = shadow_of(scene_with(flat(), box(17.0)))
    points = torch.stack([on_road([16.0, 19.0, 25.0], 0.6), on_road([19.0, 16.0, 10.0], 0.6)])
    assert visible(shadow.to(device), points.to(device)).tolist() == [[True, False, False], [False, True, True]]
