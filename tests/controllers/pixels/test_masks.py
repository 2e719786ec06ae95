"""Weights and masks: what an infinite weight rules, and that no light reaches what is masked."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import Primitives, concatenate, rectangle
from luxloop.controllers.pixels.rthc import trace
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised, lamp

LAMP = idealised(20, 40)
T = pose_from_degrees((0.0, 0.0, 0.0))
FULL = torch.ones(LAMP.n_pixels)
SEEN_FROM_THE_LAMP = torch.tensor([-1.0, 0.0, 0.0])


def board(y: float, z: float, width: float, height: float, x: float = 20.0, turn: float = 0.0, **changes) -> Primitives:
    """An upright rectangle about (x, y, z), turned in its plane."""
    c, s = math.cos(turn), math.sin(turn)
    d1, d2 = torch.tensor([0.0, -width * c, -width * s]), torch.tensor([0.0, height * s, -height * c])
    origin = torch.tensor([x, y, z]) - (d1 + d2) / 2
    return rectangle(origin, d1, d2, **{"value": 0.0, "normal": SEEN_FROM_THE_LAMP, **changes})


def mask(*place: float, **changes) -> Primitives:
    return board(*place, weight=math.inf, forced=True, **changes)


def light_at(u: torch.Tensor, primitive: Primitives, n: int = 25) -> torch.Tensor:
    """Luminous intensities `[n * n]` towards points spread over a primitive, its edges included."""
    s = torch.linspace(0, 1, n)
    points = primitive.origin[0] + s[:, None, None] * primitive.d1[0] + s[None, :, None] * primitive.d2[0]
    return LAMP.intensity(LAMP.light_texture(u), points.flatten(0, 1).T)


places = st.tuples(st.floats(-2, 2), st.floats(-1, 0.3), st.floats(0.001, 1), st.floats(0.001, 0.6), st.floats(10, 40), st.floats(0, 1.5))


@settings(max_examples=60)
@given(places)
def test_no_light_reaches_a_masked_body_however_thin_and_few_texels_more_are_dark(place):
    dark = mask(*place)
    u = Ssc.prepare(LAMP, default=FULL).utilisation(dark, T).u
    assert not light_at(u, dark).any()
    assert (u == 0).any() or not light_at(FULL, dark).any()
    hit = trace(dark, LAMP, T).hit
    corners = dark.corners()[0, [0, 1, 3, 2]]
    row, col = LAMP.texel_of(corners[:, 1] / corners[:, 0], corners[:, 2] / corners[:, 0])
    low, high = torch.stack([row, col]).amin(1) - 1.52, torch.stack([row, col]).amax(1) + 1.52
    at = torch.nonzero(hit)
    assert (at + 0.5 >= low).all() and (at + 0.5 <= high + 1e-3).all()


def test_infinite_beats_finite_and_forced_beats_near():
    near = board(0.0, 0.0, 100.0, 100.0, x=10.0, value=1.0, weight=1e6)
    far = board(0.0, 0.0, 100.0, 100.0, x=30.0, weight=math.inf)
    ssc = Ssc.prepare(LAMP)
    assert (ssc.utilisation(concatenate(near, far), T).u == 1).all(), "the mask lies behind and is not forced"
    far = board(0.0, 0.0, 100.0, 100.0, x=30.0, weight=math.inf, forced=True)
    assert not ssc.utilisation(concatenate(near, far), T).u.any()
    above = board(0.0, 0.0, 100.0, 100.0, x=40.0, value=0.7, forced=True, priority=1)
    u = ssc.utilisation(concatenate(above, near, far), T).u
    torch.testing.assert_close(u, torch.full_like(u, 0.7))
    second = board(0.0, 0.0, 100.0, 100.0, value=0.6)
    for priority, wins in ((0, 0.6), (1, 0.2)):  # in one plane: the later, unless the first is more important
        first = board(0.0, 0.0, 100.0, 100.0, value=0.2, priority=priority)
        assert ssc.utilisation(concatenate(first, second), T).u.mean().item() == pytest.approx(wins)


@pytest.mark.parametrize(
    "changes",
    [
        {"lower_cd": 5000.0},
        {"a_ac": 1.0},
        {"a_x": 1.0},
        {"sampling": "brightest"},
        {"a_d": 2.0},
        *({"a_r": a_r} for a_r in (0.0, 2.0, 8.0)),
    ],
)
def test_nothing_lifts_a_mask(changes):
    """Its texels are pixels' faintest too, of 1e-4 of their peaks and less."""
    light, dark = lamp("hd84").finest.headlight, mask(0.0, -0.3, 0.6, 0.4)
    u = Ssc.prepare(light, MrpcParams(**changes), torch.ones(light.n_pixels)).utilisation(dark, T).u
    assert not light.light_texture(u)[trace(dark, light, T).hit].any()


@pytest.mark.parametrize("weight", [1e12, 1e15, 1e30, 1e38])
def test_heavy_light_beside_a_mask_is_neither_brighter_nor_dark(weight):
    """All that is heavier than the default by far gives the same: its setpoint, in pixels that the mask leaves."""
    dark, ssc = mask(0.3, -0.2, 0.4, 0.3), Ssc.prepare(LAMP)
    expected, heavy = (ssc.utilisation(concatenate(board(0.0, 0.0, 8.0, 4.0, value=0.5, weight=each), dark), T).u for each in (1e9, weight))
    assert ((expected > 0.4) & (expected < 0.5 + 1e-6)).any() and (expected == 0).any()
    torch.testing.assert_close(heavy, expected, rtol=0, atol=1e-5)  # float32


def test_bright_setpoints_of_infinite_weight_beat_exclusion_and_activation():
    bright = board(0.3, -0.2, 0.4, 0.3, value=0.5, weight=math.inf)
    u = Ssc.prepare(LAMP, MrpcParams(a_x=1.0, a_ac=1.0), default=FULL).utilisation(bright, T).u
    assert sorted(u.unique().tolist()) == pytest.approx([0.5, 1.0])


def test_one_ray_of_infinite_weight_darkens_a_pixel_fully():
    tiny = mask(0.02, -0.11, 0.01, 0.01)
    u = Ssc.prepare(LAMP, default=FULL).utilisation(tiny, T).u
    assert 1 <= (u == 0).sum() <= 4 * 4  # the pixels that reach one of at most 2 x 2 texels
    assert ((u == 0) | (u == 1)).all()
