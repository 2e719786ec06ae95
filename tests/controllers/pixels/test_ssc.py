"""SuperSampling Control as a whole: primitives in, light on the road out."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from luxloop.controllers.pixels.jpo import Jpo
from luxloop.controllers.pixels.mrpc import same_for_all_pixels
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import Primitives, Quantity, concatenate, road_symbol
from luxloop.controllers.pixels.ssc import Ssc, WindowedSsc, window_suffices
from luxloop.controllers.pixels.windows import union
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised
from luxloop.world.light.illumination import illuminance, lit_surface
from luxloop.world.rendering.gbuffer import GBuffer
from tests.refusal import refusal

LAMP = idealised(10, 16)
T_LEFT = pose_from_degrees((0.0, 0.6, 0.75))
SYMBOL = torch.rand(6, 5, generator=torch.Generator().manual_seed(1))
TARGET = (17.0, 0.0, 0.0, 0.0)
OUT_OF_SIGHT = (17.0, 20.0, 0.0, 0.0)


def road_primitive(pose: tuple[float, ...] | Tensor, quantity: Quantity = "u_abs", value: float = 1.0) -> Primitives:
    pose = torch.as_tensor(pose)
    return road_symbol(pose, 0.0, 3.0, 8.0, SYMBOL.to(pose), value, quantity)


def test_a_base_pattern_that_goes_out_is_dark_again():
    """Only then is the band known, which spares what follows most of the lamp; light is the same either way."""
    lit = torch.full((LAMP.n_pixels,), 0.3)
    ssc, primitive = Ssc.prepare(LAMP), road_primitive(TARGET)
    burning = ssc.over(lit)
    assert ssc.dark and not burning.dark and burning.over(torch.zeros_like(lit)).dark
    light = burning.utilisation(primitive, T_LEFT)
    assert light.band is None and (light.u == 0.3).sum() > LAMP.n_pixels // 2
    out, plain = burning.over(torch.zeros_like(lit)).utilisation(primitive, T_LEFT), ssc.utilisation(primitive, T_LEFT)
    assert out.band == plain.band is not None and torch.equal(out.u, plain.u)
    outside = torch.ones(LAMP.n_pixels, dtype=torch.bool)
    outside[plain.band] = False
    assert outside.any() and not plain.u[outside].any()


def test_light_that_is_changed_by_its_user_changes_no_controller():
    default = torch.rand(LAMP.n_pixels, generator=torch.Generator().manual_seed(3))
    ssc, before = Ssc.prepare(LAMP, default=default), default.clone()
    for pose in (TARGET, OUT_OF_SIGHT):
        ssc.utilisation(road_primitive(pose), T_LEFT).u.mul_(0.5)
        assert torch.equal(ssc.default, before)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_light_is_in_the_dtype_of_the_lamp(dtype):
    lamp = replace(LAMP, matrix=LAMP.matrix.to(dtype))
    default = torch.full((LAMP.n_pixels,), 0.3, dtype=dtype)
    for controller in (Ssc.prepare(lamp, default=default), Jpo.prepare(lamp, default=default)):
        single, double = (
            controller.utilisation(road_primitive(torch.tensor(TARGET, dtype=each), "E_v", 2.0), T_LEFT).u
            for each in (torch.float32, torch.float64)
        )
        assert single.dtype == double.dtype == dtype
        # Places and pictures are rounded to 6e-8 of theirs, and a ray at an outline may fall either way.
        assert ((single - double).abs() > 1e-4).sum() < 0.02 * LAMP.n_pixels


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused(value):
    """One of them would spread over the pixels of its whole batch."""
    primitive = road_primitive(TARGET, value=1.0)
    broken = concatenate(primitive, replace(primitive, value=torch.tensor([value])))
    batch = replace(broken, **{name: getattr(broken, name).expand(2, 2, 3) for name in ("origin", "d1", "d2", "normal")})
    batch = replace(batch, value=torch.tensor([[1.0, 1.0], [1.0, value]]), weight=broken.weight.expand(2, 2))
    for controller in (Ssc.prepare(LAMP), Jpo.prepare(LAMP)):
        for scene in (broken, batch):
            with refusal(r"value is infinite or not a number; give a finite one"):
                controller.utilisation(scene, T_LEFT)


def road(x: Tensor, y: Tensor) -> GBuffer:
    position = torch.stack([x, y, torch.zeros_like(x)])
    normal = torch.zeros_like(position)
    normal[2] = 1
    return GBuffer(position, normal, torch.full_like(x, 0.2), torch.zeros_like(x, dtype=torch.int32))


def lit_road(lamp: Headlight, u: Tensor, x: Tensor, y: Tensor) -> Tensor:
    surface = lit_surface(road(x, y), lamp, T_LEFT)
    light = torch.zeros(x.numel())
    light[surface.index] = illuminance(surface, lamp.light_texture(u))
    return light.view(x.shape)


def test_the_road_gets_the_illuminance_that_was_asked_for():
    lamp = idealised(60, 40)
    x, y = torch.meshgrid(torch.linspace(15, 19, 81), torch.linspace(-1, 1, 21), indexing="ij")
    primitive = road_symbol(torch.tensor(TARGET), 0.0, 4.0, 8.0, torch.ones(1, 1), 1.5, "E_v")
    u = Ssc.prepare(lamp).utilisation(primitive, T_LEFT).u
    assert u.max() < 1
    light = lit_road(lamp, u, x, y)
    # A pixel spans half a metre of road, over which the light needed for a constant illuminance changes by 3 x / 17 m, 10 %.
    torch.testing.assert_close(light, torch.full_like(light, 1.5), rtol=0.06, atol=0)
    assert light.mean().item() == pytest.approx(1.5, rel=0.005)


def test_light_lies_on_the_symbol_and_not_beside_it():
    lamp = idealised(60, 120)
    x, y = torch.meshgrid(torch.linspace(13, 24, 111), torch.linspace(-2, 2, 81), indexing="ij")
    primitive = road_symbol(torch.tensor(TARGET), 0.0, 2.0, 4.0, torch.ones(1, 1), 1.0, "u_abs")
    u = Ssc.prepare(lamp).utilisation(primitive, T_LEFT).u
    on = lit_road(lamp, u, x, y) > 0.5 * lit_road(lamp, torch.ones_like(u), x, y)
    symbol = ((x - 17).abs() < 2) & (y.abs() < 1)
    # A pixel is 0.6 m long and 5 cm wide there, the symbol 4 m x 2 m: a third of a pixel along each short edge is 10 % of the area.
    assert (on ^ symbol).sum() < 0.1 * symbol.sum()
    assert x[on].mean().item() == pytest.approx(17, abs=0.1)
    assert y[on].mean().item() == pytest.approx(0, abs=0.02)


@pytest.mark.parametrize(("quantity", "value"), [("u_abs", 1.0), ("E_v", 20.0)])
@pytest.mark.parametrize("batch", [(), (2,)])
def test_pose_gradients_are_those_of_differences(batch, quantity, value):
    ssc = Ssc.prepare(replace(LAMP, matrix=LAMP.matrix.to(torch.float64)))
    smooth = torch.hann_window(64, periodic=False, dtype=torch.float64)
    symbol = smooth[:, None] * smooth  # dark at the outline, so that hits and misses join without a step

    def light(pose: Tensor) -> Tensor:
        return ssc.utilisation(road_symbol(pose, 0.0, 3.0, 8.0, symbol, value, quantity), T_LEFT).u.square().sum(-1)

    pose = torch.tensor([17.0, 0.2, 0.02, -0.03], dtype=torch.float64).expand(*batch, 4).clone().requires_grad_()
    # Bilinear kinks every 1/64 of the symbol and a border clamped over half a texel: a hundredth.
    assert torch.autograd.gradcheck(light, (pose,), eps=1e-5, rtol=0.01, atol=1e-3)


@pytest.mark.parametrize(("quantity", "value"), [("u_abs", 0.8), ("I_v", 3000.0), ("E_v", 20.0)])
@pytest.mark.parametrize("params", [MrpcParams(), MrpcParams(a_r=2.0), MrpcParams(a_d=1.5)])
def test_utilisations_are_those_of_the_whole_lamp(quantity, value, params):
    ssc = Ssc.prepare(LAMP, params)
    primitives = [road_primitive(pose, quantity, value) for pose in (TARGET, (18.0, 0.4, 0.01, 0.0), (15.5, -0.3, -0.02, 0.0))]
    assert window_suffices(ssc, primitives[0], T_LEFT)
    castings = [ssc.ray_batch(each, T_LEFT) for each in primitives]
    part = WindowedSsc.of(ssc, union([each.window for each in castings]).widen(2, LAMP.rows, LAMP.cols))
    beside = torch.ones(LAMP.n_pixels, dtype=torch.bool)
    beside[part.pixels] = False
    assert beside.any(), "the window is a part of the lamp"
    for each, casting in zip(primitives, castings, strict=True):
        expected = ssc.utilisation(each, T_LEFT).u
        assert expected.any() and not expected[beside].any()
        # Sums of the same numbers, of which other kernels may take the order that suits them.
        torch.testing.assert_close(part.utilisation(casting), expected[part.pixels], rtol=1e-6, atol=1e-7)


def test_what_needs_more_than_a_windows_products_is_told():
    one, dark = road_primitive(TARGET), Ssc.prepare(LAMP)
    assert not window_suffices(dark.over(torch.full((LAMP.n_pixels,), 0.1)), one, T_LEFT), "a base beam shines beside it"
    assert not window_suffices(dark, concatenate(one, one), T_LEFT)
    mask = replace(one, value=torch.zeros_like(one.value), weight=torch.full_like(one.weight, torch.inf))
    assert not window_suffices(dark, mask, T_LEFT)
    for params in (MrpcParams(a_ac=0.5), MrpcParams(sharpening=1.0), MrpcParams(corrections=1), MrpcParams(upper_cd=100.0)):
        assert not window_suffices(Ssc.prepare(LAMP, params), one, T_LEFT)


def test_a_share_beside_lux_costs_no_more_than_shares_alone():
    """Only shares above one need the mapping entry by entry, which takes ten times as long."""
    ssc = Ssc.prepare(LAMP, default=torch.full((LAMP.n_pixels,), 0.5))
    for share in (0.5, 1.5):
        scene = concatenate(road_primitive(TARGET, "u_rel", share), road_primitive(TARGET, "E_v", 5.0))
        assert same_for_all_pixels(ssc.ray_batch(scene, T_LEFT), ssc.pixels, ssc.params, ssc.dark) == (share < 1)
