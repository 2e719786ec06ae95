"""Products on one window of the light texture: the same utilisations as of the whole."""

from dataclasses import replace

import pytest
import torch

from luxloop.controllers.pixels.mrpc import MrpcParams
from luxloop.controllers.pixels.primitives import Primitives, Quantity, concatenate, road_symbol
from luxloop.controllers.pixels.ssc import Ssc, WindowedSsc, serves
from luxloop.controllers.pixels.windows import union
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised

LAMP = idealised(10, 16)
T_LEFT = pose_from_degrees((0.0, 0.6, 0.75))
SYMBOL = torch.rand(6, 5, generator=torch.Generator().manual_seed(1))


def primitive(x: float, y: float = 0.0, roll: float = 0.0, quantity: Quantity = "u_abs", value: float = 1.0) -> Primitives:
    return road_symbol(torch.tensor([x, y, roll, 0.0]), 0.0, 3.0, 8.0, SYMBOL, value, quantity)


@pytest.mark.parametrize(("quantity", "value"), [("u_abs", 0.8), ("I_v", 3000.0), ("E_v", 20.0)])
@pytest.mark.parametrize("params", [MrpcParams(), MrpcParams(a_r=2.0), MrpcParams(a_d=1.5)])
def test_utilisations_are_those_of_the_whole_lamp(quantity: Quantity, value: float, params: MrpcParams) -> None:
    ssc = Ssc.prepare(LAMP, params)
    primitives = [primitive(*pose, quantity=quantity, value=value) for pose in ((17.0,), (18.0, 0.4, 0.01), (15.5, -0.3, -0.02))]
    assert serves(ssc, primitives[0], T_LEFT)
    castings = [ssc.ray_batch(each, T_LEFT) for each in primitives]
    part = WindowedSsc.of(ssc, union([each.window for each in castings]).widen(2, LAMP))
    beside = torch.ones(LAMP.n_pixels, dtype=torch.bool)
    beside[part.pixels] = False
    assert beside.any(), "the window is a part of the lamp"
    for each, casting in zip(primitives, castings, strict=True):
        expected = ssc.utilisation(each, T_LEFT).u
        assert expected.any() and not expected[beside].any()
        # Sums of the same numbers, of which other kernels may take the order that suits them.
        torch.testing.assert_close(part.utilisation(casting), expected[part.pixels], rtol=1e-6, atol=1e-7)


def test_what_needs_more_than_a_windows_products_is_told() -> None:
    one, dark = primitive(17.0), Ssc.prepare(LAMP)
    assert not serves(dark.over(torch.full((LAMP.n_pixels,), 0.1)), one, T_LEFT), "a base beam shines beside it"
    assert not serves(dark, concatenate(one, one), T_LEFT)
    mask = replace(one, value=torch.zeros_like(one.value), weight=torch.full_like(one.weight, torch.inf))
    assert not serves(dark, mask, T_LEFT)
    for params in (MrpcParams(a_ac=0.5), MrpcParams(sharpening=1.0), MrpcParams(corrections=1), MrpcParams(upper_cd=100.0)):
        assert not serves(Ssc.prepare(LAMP, params), one, T_LEFT)
