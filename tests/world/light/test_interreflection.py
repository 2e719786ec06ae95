"""Light that surfaces reflect onto each other, against form factors of textbooks, and its energy."""

import math

import pytest
import torch

from luxloop.world.frames import T_ISO_OPENCV, View, pose_from_degrees
from luxloop.world.light.emitters import Source, surface_light
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.light.interreflection import Interreflection, gather
from luxloop.world.rendering.gbuffer import gbuffer
from luxloop.world.rendering.surfaces import face_source
from luxloop.world.roads.shapes import Flat
from luxloop.world.scene.body import Body
from luxloop.world.scene.ground import road_mesh
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Triangles
from luxloop.world.traffic.objects import BoxParams
from tests.world.light.test_volumetric import uniform

UP, LEFT = torch.tensor([[0.0], [0.0], [1.0]]).double(), torch.tensor([[0.0], [1.0], [0.0]]).double()


def box(size_m: tuple[float, float, float], position_m: tuple[float, float, float], albedo: float = 0.6) -> Body:
    return BoxParams(name="box", size_m=size_m, albedo=albedo, track=[{"position_m": position_m}]).build()


def road(albedo: float = 0.2) -> Body:
    return Body("road", road_mesh(Flat()), albedo, smooth=True, ground=True)


def share(triangles: Triangles, point: tuple[float, float, float], normal: torch.Tensor) -> float:
    """Illuminance of a point by surfaces of 1 cd/m^2, as a share of that under such a sky."""
    found = gather(triangles, torch.tensor(point).double()[:, None], normal)
    return float(found.illuminance(torch.ones(len(found.point)))) / math.pi


@pytest.mark.parametrize("away_m", [0.5, 1.0, 2.0, 5.0])
def test_a_wall_fills_its_share_of_the_sky(away_m):
    """A point before the middle of a perpendicular rectangle's lower edge: within 0.015, as each of 256 rays weighs up to 2/256."""
    half, height = 4.0, 3.0
    found = share(Scene((box((2 * half, 0.4, height), (0.0, 0.2, 0.0)),)).at(0.0), (0.0, -away_m, 0.0), UP)
    slant = math.hypot(away_m, height)
    assert found == pytest.approx((math.atan(half / away_m) - away_m / slant * math.atan(half / slant)) / math.pi, abs=0.015)


@pytest.mark.parametrize("away_m", [0.5, 1.0, 2.0, 5.0])
def test_a_parallel_rectangle_fills_its_share(away_m):
    """A point below the middle of a rectangle."""
    half_x, half_y = 2.0, 1.0
    a, b = half_x / away_m, half_y / away_m
    expected = sum(p / math.hypot(1, p) * math.atan(q / math.hypot(1, p)) for p, q in ((a, b), (b, a))) * 2 / math.pi
    found = share(Scene((box((2 * half_x, 2 * half_y, 0.1), (0.0, 0.0, away_m)),)).at(0.0), (0.0, 0.0, 0.0), UP)
    assert found == pytest.approx(expected, abs=0.015)


def test_a_body_between_takes_the_light():
    wall, screen = box((8.0, 0.4, 3.0), (0.0, 2.2, 0.0)), box((8.0, 0.1, 3.0), (0.0, 1.0, 0.0), albedo=0.0)
    found = gather(Scene((wall, screen)).at(0.0), torch.zeros(3, 1).double(), UP)
    assert len(found.point) and not found.surfaces.albedo.any(), "only the black screen is seen"


def test_all_light_stays_in_a_closed_room():
    """Every ray meets a wall, the ceiling or the floor, however near a corner."""
    walls = [((4.4, 0.2, 3), (0, 2.1, 0)), ((4.4, 0.2, 3), (0, -2.1, 0)), ((0.2, 4, 3), (2.1, 0, 0)), ((0.2, 4, 3), (-2.1, 0, 0))]
    room = Scene(tuple(box(*each) for each in [*walls, ((4.4, 4.4, 0.2), (0, 0, 3)), ((4.4, 4.4, 0.2), (0, 0, -0.2))])).at(0.0)
    assert (share(room, (1.9, 1.9, 0.01), UP), share(room, (1.9, -1.99, 2.9), LEFT)) == pytest.approx((1, 1), abs=1e-5)


@pytest.fixture(scope="module")
def street() -> tuple[Triangles, Interreflection, Source]:
    """A wall beside the road, seen from far above, in the light of a lamp of 1,000 cd in all directions within 45 deg."""
    wall = box((16.0, 0.3, 3.0), (14.0, 4.15, 0.0))
    triangles, lamp = Scene((road(), wall)).at(0.0), uniform()
    above = View(600, 400, 1000, 1000, 300, 200, pose_from_degrees((14.0, -8.0, 50.0), pitch_deg=90) @ T_ISO_OPENCV)
    lamp = Source(lamp.headlight, torch.full_like(lamp.texture, 1000.0), pose_from_degrees((0, 0, 0.75)))
    return triangles, Interreflection(triangles, above), lamp


def test_a_wall_gives_the_road_half_of_the_light_that_it_reflects(street):
    """A matt upright surface sends half of its light down, less what falls beyond the points of the road, 14 m from the wall."""
    triangles, indirect, lamp = street
    _, leaving = surface_light(indirect.gathering.surfaces, [lamp], triangles)
    on_points = indirect.gathering.illuminance(leaving[0])
    (on_road,) = (
        float(some.sum())
        for grid, some in zip(indirect.grids, on_points.split([int(each.used.sum()) for each in indirect.grids]), strict=True)
        if grid.object_id == 0
    )
    x, z = torch.meshgrid(torch.arange(6.05, 22, 0.1).double(), torch.arange(0.05, 3, 0.1).double(), indexing="ij")
    points = torch.stack([x.flatten(), torch.full((x.numel(),), 4.0).double(), z.flatten()])
    away = lamp.T_world_source[:3, 3:] - points
    arriving = float(lux_per_cd(away, -LEFT).sum()) * 1000 * 0.1**2
    assert 0.44 < on_road / (0.6 * arriving) < 0.5


def test_light_is_interpolated_between_points(street):
    """As gathered at the pixels themselves: within 10 % in the median where the road gets a tenth of the most; both have noise."""
    triangles, _, lamp = street
    view = View(40, 30, 75, 75, 20, 15, pose_from_degrees((-1.6, 0, 1.35), pitch_deg=3, yaw_deg=8) @ T_ISO_OPENCV)
    seen = gbuffer(triangles, view, face_source("raycast").face_ids(triangles, view))
    here = Interreflection(triangles, view)
    _, leaving = surface_light(here.gathering.surfaces, [lamp], triangles)
    image = here.onto(seen)(here.gathering.illuminance(leaving[0])).flatten()
    pixels = torch.nonzero((seen.object_id.flatten() == 0) & (image > 0.1 * image.max()))[:, 0]
    exact = gather(triangles, seen.position.flatten(1)[:, pixels].double() + 0.01 * UP, seen.normal.flatten(1)[:, pixels].double())
    _, leaving = surface_light(exact.surfaces, [lamp], triangles)
    expected = exact.illuminance(leaving[0])
    assert float(((image[pixels] - expected) / expected).abs().median()) < 0.1
    assert float(image[pixels].sum()) == pytest.approx(float(expected.sum()), rel=0.03)
