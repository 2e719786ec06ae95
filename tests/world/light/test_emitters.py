"""Light of whole lamps on walls and in views, against I cos / d^2 written out."""

import math

import pytest
import torch

from luxloop.world.frames import R_ISO_OPENCV, View, pose, pose_from_degrees
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps.presets import idealised
from luxloop.world.light.emitters import sources, surface_light, wall_illuminance
from luxloop.world.rendering.gbuffer import flat_road

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


def test_a_lamp_beside_the_middle_shows_parallax(lamp: Lamp, pattern: tuple[torch.Tensor, ...]) -> None:
    beside = wall_illuminance(sources(lamp, pattern, LEFT), MIDDLE, torch.tensor([1.0]), torch.tensor([-1.0]), 10.0)
    point = torch.tensor([10.0, -10 * math.tan(math.radians(1)), 0.0], dtype=torch.float64)
    point[2] = 0.75 - point[:2].norm() * math.tan(math.radians(1))
    ray = point - LEFT[:3, 3]
    expected = lamp.intensity(pattern, ray[:, None]) * 10 / ray.norm() ** 3
    torch.testing.assert_close(beside, expected, rtol=1e-6, atol=0)


def test_views_show_the_sum_of_all_modules_through_the_air(lamp: Lamp, pattern: tuple[torch.Tensor, ...]) -> None:
    eye = pose_from_degrees((0.0, 0.0, 300.0), pitch_deg=90.0) @ pose(torch.zeros(3, dtype=torch.float64), R_ISO_OPENCV)
    view = View(8, 12, 60.0, 60.0, 4.0, 18.0, eye)  # 40 m wide, from 0 to 60 m ahead
    road = flat_road(view, 0.2, torch.float64)
    lit = sources(lamp, pattern, LEFT)
    ray = road.position.flatten(1) - LEFT[:3, 3:]
    d = ray.norm(dim=0)
    expected = (lamp.intensity(pattern, ray) * -ray[2] / d**3).view(12, 8)
    found, luminance = surface_light(road, lit)
    assert found.max() > 0.5
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)  # light textures are float32
    torch.testing.assert_close(luminance, 0.2 * found / math.pi)
    hazy, _ = surface_light(road, lit, extinction_per_m=0.01)
    torch.testing.assert_close(hazy, expected * torch.exp(-0.01 * d).view(12, 8), rtol=1e-5, atol=1e-6)
