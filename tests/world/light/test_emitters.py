"""Light of sky, street lamps and spotlights, and of modules on walls and in views."""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from luxloop.world.frames import T_ISO_OPENCV, View, pose_from_degrees
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps.presets import idealised
from luxloop.world.light.emitters import ambient_luminance, sources, surface_light, wall_illuminance
from luxloop.world.materials.brdf import LAMBERTIAN, Material
from luxloop.world.rendering.gbuffer import Finish, GBuffer, flat_road
from luxloop.world.scene.air import Medium
from luxloop.world.scene.body import Spotlight
from luxloop.world.scene.scene import StreetLamp

LEFT = pose_from_degrees((0.0, 0.6, 0.75))
MIDDLE = pose_from_degrees((0.0, 0.0, 0.75))


@pytest.fixture(scope="module")
def lamp() -> Lamp:
    """Two modules, one of them turned aside."""
    light = idealised(12, 20, (4, 4))
    return Lamp("lamp", (Module("near", light), Module("far", light, pose_from_degrees((0.0, 0.0, 0.0), yaw_deg=4.0))))


@pytest.fixture(scope="module")
def pattern(lamp: Lamp) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(3)
    return tuple(torch.rand(module.headlight.n_pixels, generator=generator) for module in lamp.modules)


def test_a_lamp_beside_the_middle_shows_parallax(lamp, pattern):
    beside = wall_illuminance(sources(lamp, pattern, LEFT), MIDDLE, torch.tensor([1.0]), torch.tensor([-1.0]), 10.0)
    point = torch.tensor([10.0, -10 * math.tan(math.radians(1)), 0.0], dtype=torch.float64)
    point[2] = 0.75 - point[:2].norm() * math.tan(math.radians(1))
    ray = point - LEFT[:3, 3]
    expected = lamp.intensity(pattern, ray[:, None]) * 10 / ray.norm() ** 3
    assert_close(beside, expected, rtol=1e-6, atol=0)


def test_views_show_the_sum_of_all_modules_through_the_air(lamp, pattern):
    eye = pose_from_degrees((0.0, 0.0, 300.0), pitch_deg=90.0) @ T_ISO_OPENCV
    view = View(8, 12, 60.0, 60.0, 4.0, 18.0, eye)  # 40 m wide, from 0 to 60 m ahead
    road = flat_road(view, 0.2, torch.float64)
    lit = sources(lamp, pattern, LEFT)
    ray = road.position.flatten(1) - LEFT[:3, 3:]
    d = ray.norm(dim=0)
    expected = (lamp.intensity(pattern, ray) * -ray[2] / d**3).view(12, 8)
    found, luminance = surface_light(road, lit)
    assert found.max() > 0.5
    assert_close(found, expected, rtol=1e-5, atol=1e-6)  # light textures are float32
    assert_close(luminance, 0.2 * found / math.pi)
    hazy, _ = surface_light(road.in_air(Medium(0.01, 0.01), view.origin), lit)
    assert_close(hazy, expected * torch.exp(-0.01 * d).view(12, 8), rtol=1e-5, atol=1e-6)


def surfaces(device: torch.device) -> GBuffer:
    """Four pixels: a road, a wall, a ceiling, nothing."""
    normal = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, 0, -1], [0, 0, 0]], device=device).T[:, None]
    position = torch.tensor([[3.0, 0, 0], [3, 0, 0], [3, 0, 0], [0, 0, 0]], device=device).T[:, None]
    albedo = torch.tensor([[0.5, 0.2, 0.2, 0.0]], device=device)
    return GBuffer(position, normal, albedo, torch.tensor([[0, 1, 2, -1]], device=device, dtype=torch.int32))


def test_a_wall_sees_half_the_sky_and_a_ceiling_none(device):
    luminance = ambient_luminance(surfaces(device), 10.0)
    expected = torch.tensor([[0.5 * 10, 0.2 * 5, 0.0, 0.0]], device=device) / math.pi
    assert_close(luminance, expected)


def test_street_lamps_add_up_by_the_inverse_square_law(device):
    lamps = [StreetLamp(position_m=(0.0, 0.0, 4.0), intensity_cd=1000.0), StreetLamp(position_m=(3.0, 0.0, 2.0), intensity_cd=100.0)]
    luminance = ambient_luminance(surfaces(device), 0.0, lamps)
    # (3, 0, 0) is 5 m from the first lamp: cos 4/5 on the road, 3/5 on the wall; 2 m below the second, which grazes the wall.
    expected = torch.tensor([[0.5 * (1000 * 0.8 / 25 + 100 / 4), 0.2 * 1000 * 0.6 / 25, 0.0, 0.0]], device=device) / math.pi
    assert_close(luminance, expected)


def test_spotlights_fall_off_with_the_angle_and_shining_surfaces_add_their_own(device):
    """The axis points down at (3, 0, 0), 5 m away, but for 10 deg aside: exp(-1/2) at a width of 10 deg."""
    down = pose_from_degrees((0.0, 0.0, 4.0), pitch_deg=math.degrees(math.atan2(4, 3)))
    for yaw_deg, share in ((0.0, 1.0), (10.0, math.exp(-0.5))):
        axis = (down @ pose_from_degrees((0.0, 0.0, 0.0), yaw_deg=yaw_deg))[:3, 0]
        spot = Spotlight(down[:3, 3], axis, 1000.0, (10.0, 10.0))
        luminance = ambient_luminance(surfaces(device), 0.0, (), (spot,))
        expected = torch.tensor([[0.5 * 1000 * 0.8 / 25, 0.2 * 1000 * 0.6 / 25, 0.0, 0.0]], device=device) * share / math.pi
        # aside of a tilted axis the two angles are not quite those of one turn: 0.02 % of the light
        assert_close(luminance, expected, rtol=1e-5 if share == 1 else 1e-3, atol=1e-6)
    finish = Finish((LAMBERTIAN, Material(luminance_cd_m2=600.0)), torch.tensor([[0, 1, 0, 0]], device=device), torch.zeros(3))
    luminance = ambient_luminance(replace(surfaces(device), finish=finish), 0.0)
    assert luminance.tolist() == [[0.0, 600.0, 0.0, 0.0]]
