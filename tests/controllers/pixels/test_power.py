"""The power limit of a lamp, and the flux of its pixels."""

import pytest
import torch

from luxloop.controllers.pixels.mrpc import limit_power
from luxloop.world.lamps.presets import idealised
from tests.refusal import refusal

LAMP = idealised(8, 20)


def test_a_power_limit_dims_all_alike_and_tells_by_how_much():
    u, power = torch.tensor([[0.5, 1.0], [0.1, 0.1]]), torch.tensor([2.0, 4.0])
    dimmed, factor = limit_power(u, power, 2.5)
    assert factor.tolist() == [0.5, 1.0]
    assert dimmed.tolist() == [[0.25, 0.5], u[1].tolist()]
    assert limit_power(torch.zeros(2), power, 0.0)[1].item() == 1
    with refusal("below zero"):
        limit_power(u, power, -1.0)


def test_flux_of_pixels_adds_up_to_the_lamp_s():
    y, z = LAMP.tangents()
    area = (LAMP.left - LAMP.right) * (LAMP.top - LAMP.bottom) / LAMP.n_texels
    light = LAMP.light_texture(torch.ones(LAMP.n_pixels)).double()
    expected = (light * area / (1 + y * y + z[:, None] ** 2) ** 1.5).sum().item()
    assert LAMP.pixel_flux.sum().item() == pytest.approx(expected, rel=1e-4)
