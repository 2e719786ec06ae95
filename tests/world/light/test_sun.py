"""A low sun on a road: Lambert's law, its mirror image in water, and shadows as long as they have to be."""

import math

import pytest
import torch

from luxloop.world.frames import T_ISO_OPENCV, View, pose_from_degrees
from luxloop.world.light.emitters import sun_luminance
from luxloop.world.materials.library import MATERIALS
from luxloop.world.rendering.gbuffer import flat_road, gbuffer
from luxloop.world.rendering.surfaces import face_source
from luxloop.world.roads.shapes import Flat
from luxloop.world.scene.body import Body
from luxloop.world.scene.ground import road_mesh
from luxloop.world.scene.scene import SUN_M, Scene, SunParams
from luxloop.world.traffic.objects import BoxParams
from tests.world.grids import camera

VIEW = camera(320, 180)
ABOVE = View(
    240, 160, 4.0 * 100, 4.0 * 100, 120.0, 80.0, pose_from_degrees((20.0, 0.0, 100.0), pitch_deg=90.0) @ T_ISO_OPENCV
)  # 0.25 m a px


@pytest.mark.parametrize("elevation_deg", [2.0, 10.0, 60.0])
def test_a_matt_road_follows_lamberts_law(elevation_deg):
    sun, road = SunParams(azimuth_deg=50.0, elevation_deg=elevation_deg, illuminance_lx=3000.0), flat_road(VIEW, 0.2)
    found = sun_luminance(road, sun)
    on_road = road.object_id >= 0
    assert float(found[~on_road].abs().sum()) == 0
    expected = torch.full_like(found[on_road], 0.2 * 3000 * math.sin(math.radians(elevation_deg)) / math.pi)
    torch.testing.assert_close(found[on_road], expected, rtol=1e-5, atol=0)


def test_a_wet_road_mirrors_it_below_the_sun():
    sun = SunParams(azimuth_deg=4.0, elevation_deg=8.0)
    found = sun_luminance(flat_road(VIEW, 0.12, material=MATERIALS["wet_asphalt"]), sun)
    dry = sun_luminance(flat_road(VIEW, 0.2), sun)
    column = int(found.argmax()) % VIEW.width
    below = VIEW.origin + torch.tensor([20 * math.cos(math.radians(4)), 20 * math.sin(math.radians(4)), 0.0], dtype=torch.float64)
    at, _ = VIEW.project(below[:, None])
    assert column + 0.5 == pytest.approx(float(at[0]), abs=2)
    assert float(found.max()) > 20 * float(dry.max())
    behind = sun_luminance(flat_road(VIEW, 0.12, material=MATERIALS["wet_asphalt"]), sun.model_copy(update={"azimuth_deg": 180.0}))
    assert float(behind.max()) < float(dry.max()), "with the sun behind, water is darker"


@pytest.mark.parametrize("elevation_deg", [15.0, 40.0])
def test_a_box_of_1_m_has_a_shadow_of_its_height_by_the_tangent(elevation_deg):
    """To 2 pixels of 0.25 m. The sun is ahead, so the shadow reaches from the box at 20 m towards the car."""
    sun = SunParams(elevation_deg=elevation_deg)
    track = [{"position_m": (20.5, 0.0, 0.0)}]
    objects = BoxParams(name="box", size_m=(1.0, 6.0, 1.0), track=track).build()
    triangles = Scene((Body("road", road_mesh(Flat()), 0.2), objects)).at(0.0)
    seen = gbuffer(triangles, ABOVE, face_source("raycast").face_ids(triangles, ABOVE))
    found = sun_luminance(seen, sun, triangles, ABOVE.origin)
    dark = (found == 0) & (seen.object_id == 0) & (seen.position[1].abs() < 1)
    reach_m = 20.0 - float(seen.position[0][dark].min())
    assert reach_m == pytest.approx(1 / math.tan(math.radians(elevation_deg)), abs=0.5)


def test_it_is_as_bright_and_wide_as_a_lamp_at_its_distance():
    sun = SunParams(illuminance_lx=1000.0)
    assert sun.intensity_cd / SUN_M**2 == pytest.approx(1000.0)
    assert math.degrees(sun.diameter_m / SUN_M) == pytest.approx(0.53, rel=1e-4)
    assert float(sun.direction.norm()) == pytest.approx(1.0)
