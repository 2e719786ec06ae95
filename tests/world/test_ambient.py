"""Ambient light against closed forms."""

import math

import torch

from world.ambient import ambient_luminance
from world.gbuffer import GBuffer
from world.scene import StreetLamp


def surfaces(device: torch.device) -> GBuffer:
    """Four pixels: a road, a wall, a ceiling, nothing."""
    normal = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, 0, -1], [0, 0, 0]], device=device).T[:, None]
    position = torch.tensor([[3.0, 0, 0], [3, 0, 0], [3, 0, 0], [0, 0, 0]], device=device).T[:, None]
    albedo = torch.tensor([[0.5, 0.2, 0.2, 0.0]], device=device)
    return GBuffer(position, normal, albedo, torch.tensor([[0, 1, 2, -1]], device=device, dtype=torch.int32))


def test_a_wall_sees_half_the_sky_and_a_ceiling_none(device: torch.device) -> None:
    luminance = ambient_luminance(surfaces(device), 10.0)
    expected = torch.tensor([[0.5 * 10, 0.2 * 5, 0.0, 0.0]], device=device) / math.pi
    torch.testing.assert_close(luminance, expected)


def test_street_lamps_add_up_by_the_inverse_square_law(device: torch.device) -> None:
    lamps = [StreetLamp(position_m=(0.0, 0.0, 4.0), intensity_cd=1000.0), StreetLamp(position_m=(3.0, 0.0, 2.0), intensity_cd=100.0)]
    luminance = ambient_luminance(surfaces(device), 0.0, lamps)
    # (3, 0, 0) is 5 m from the first lamp: cos 4/5 on the road, 3/5 on the wall; 2 m below the second, which grazes the wall.
    expected = torch.tensor([[0.5 * (1000 * 0.8 / 25 + 100 / 4), 0.2 * 1000 * 0.6 / 25, 0.0, 0.0]], device=device) / math.pi
    torch.testing.assert_close(luminance, expected)
