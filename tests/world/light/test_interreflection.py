"""Light that surfaces reflect onto each other, against form factors of textbooks, and its energy."""

import math
from dataclasses import replace

import pytest
import torch

from luxloop.world.frames import T_ISO_OPENCV, View, pose_from_degrees
from luxloop.world.light import interreflection
from luxloop.world.light.emitters import Source, surface_light
from luxloop.world.light.illumination import luminance_factors, lux_per_cd
from luxloop.world.light.interreflection import Interreflection, gather, glitter
from luxloop.world.materials.library import WET
from luxloop.world.rendering.gbuffer import gbuffer
from luxloop.world.rendering.surfaces import face_source
from luxloop.world.roads.shapes import Flat
from luxloop.world.scene.body import Body
from luxloop.world.scene.ground import road_mesh
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Triangles
from luxloop.world.traffic.objects import BoxParams
from tests.world.light.test_volumetric import uniform

AHEAD, LEFT, UP = torch.eye(3, dtype=torch.float64)[..., None]


def box(size_m: tuple[float, float, float], position_m: tuple[float, float, float], albedo: float = 0.6) -> Body:
    return BoxParams(name="box", size_m=size_m, albedo=albedo, track=[{"position_m": position_m}]).build()


def road(albedo: float = 0.2) -> Body:
    return Body("road", road_mesh(Flat()), albedo, smooth=True, ground=True)


def share(triangles: Triangles, point: tuple[float, float, float], normal: torch.Tensor) -> float:
    """Illuminance of a point by surfaces of 1 cd/m^2, as a share of that by a whole sky of it."""
    found = gather(triangles, torch.tensor(point).double()[:, None], normal)
    return float(found.illuminance(torch.ones(len(found.point)), 1)) / math.pi


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
    return triangles, Interreflection(triangles, above, torch.zeros(0, 3)), lamp


def test_a_wall_gives_the_road_half_of_the_light_that_it_reflects(street):
    """A matt upright surface sends half of its light down, less what falls beyond the points of the road, 14 m from the wall."""
    triangles, indirect, lamp = street
    _, leaving = surface_light(indirect.gatherings[0].surfaces, [lamp], triangles)
    on_points = indirect.gatherings[0].illuminance(leaving[0], indirect.points[0].shape[1])
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
    here = Interreflection(triangles, view, torch.zeros(0, 3))
    _, leaving = surface_light(here.gatherings[0].surfaces, [lamp], triangles)
    image = here.onto(seen)(here.gatherings[0].illuminance(leaving[0], here.points[0].shape[1])).flatten()
    pixels = torch.nonzero((seen.object_id.flatten() == 0) & (image > 0.1 * image.max()))[:, 0]
    exact = gather(triangles, seen.position.flatten(1)[:, pixels].double() + 0.01 * UP, seen.normal.flatten(1)[:, pixels].double())
    _, leaving = surface_light(exact.surfaces, [lamp], triangles)
    expected = exact.illuminance(leaving[0], len(pixels))
    assert float(((image[pixels] - expected) / expected).abs().median()) < 0.1
    assert float(image[pixels].sum()) == pytest.approx(float(expected.sum()), rel=0.03)


def shine(roughness: float, length_m: float, lamp_height_m: float, eye_height_m: float) -> float:
    """Illuminance in lx of an upright surface by gloss of a flat road in the light of 1,000 cd."""
    film = Body("road", road_mesh(Flat()), 0.12, material=replace(WET, roughness=roughness), smooth=True, ground=True)
    lamp, eye = torch.tensor([0, 0, lamp_height_m]).double(), torch.tensor([[length_m], [0], [eye_height_m]]).double()
    found = glitter(Scene((film,)).at(0.0), eye, -AHEAD, torch.zeros(1).double(), lamp, roughness)
    position, normal = (each[:, 0] for each in (found.surfaces.position, found.surfaces.normal))
    away = lamp[:, None].float() - position
    factor = luminance_factors(found.surfaces, torch.arange(len(found.point)), away)
    return float(found.illuminance(1000 * lux_per_cd(away, normal) * factor / math.pi, 1))


@pytest.mark.parametrize("length_m", [2.0, 4.0, 6.0])
def test_a_smooth_film_shows_the_mirror_image_of_a_lamp(monkeypatch, length_m):
    """With Fresnel's share at the distance of the image; within 3 %, the rest is the width of the least roughness."""
    monkeypatch.setattr(interreflection, "ALONG", 400)
    ray = math.hypot(length_m, 2.0)
    share = WET.f0 + (1 - WET.f0) * (1 - 2.0 / ray) ** 5
    assert shine(0.02, length_m, 1.0, 1.0) == pytest.approx(1000 * share / ray**2 * length_m / ray, rel=0.03)


@pytest.mark.parametrize("length_m", [10.0, 50.0, 120.0])
def test_few_rays_catch_the_strip_of_a_wet_road(monkeypatch, length_m):
    """Of 96 rays as of 25,600: within 1 %."""
    found = shine(WET.roughness, length_m, 0.75, 1.2)
    monkeypatch.setattr(interreflection, "ALONG", 400)
    monkeypatch.setattr(interreflection, "ACROSS", 64)
    assert found == pytest.approx(shine(WET.roughness, length_m, 0.75, 1.2), rel=0.01)
