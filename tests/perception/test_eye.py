"""The eye: glare as the CIE has it, and pictures that keep hue, order and edges."""

import math

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given

from luxloop.perception.eye import SATURATION_CD_M2, develop, exposure_of, smooth, threshold_difference, veil
from luxloop.world.frames import T_ISO_OPENCV, View
from luxloop.world.headlight.matrix import LUMINANCE

AHEAD = View(400, 201, 1000.0, 1000.0, 200.5, 100.5, T_ISO_OPENCV)
WEIGHT = torch.tensor(LUMINANCE)[:, None, None]


def grey(*luminances: float) -> torch.Tensor:
    return torch.tensor(luminances).expand(3, 1, -1)


@pytest.mark.parametrize(
    ("age", "theta_deg", "expected"),
    [(40, 2.0, 10 / 8 + (5 / 4 + 0.05 / 2) * (1 + 0.64**4) + 0.00125), (75, 5.0, 10 / 125 + (5 / 25 + 0.05 / 5) * (1 + 1.2**4) + 0.00125)],
)
def test_veil_is_that_of_the_cie_and_light_adds_up(age, theta_deg, expected):
    source = torch.tensor([[50.0], [0.0], [0.0]], dtype=torch.float64)
    one = veil(AHEAD, source, torch.tensor([1.0]), age)
    column = math.tan(math.radians(theta_deg)) * AHEAD.fx
    left, right = one[100, 200 - round(column)], one[100, 200 + round(column)]
    # within the step from one column to the next
    assert float(left) == pytest.approx(float(right), rel=1e-4) and float(left) == pytest.approx(expected, rel=0.03)
    assert torch.allclose(veil(AHEAD, source.expand(3, 2), torch.tensor([0.25, 0.75]), age), one, rtol=1e-5)
    assert bool((veil(AHEAD, source, torch.tensor([1.0]), age + 20) > one).all()), "older eyes scatter more"


@pytest.mark.parametrize(
    ("background", "size_arcmin", "darker", "age_years", "expected"),
    [
        (1.0, 10.0, False, 25, 0.08152),
        (0.1, 10.0, True, 25, 0.01301),
        (0.01, 20.0, False, 60, 0.008633),
        (0.001, 30.0, True, 40, 0.0007395),
    ],
)
def test_threshold_is_that_of_adrian(background, size_arcmin, darker, age_years, expected):
    """Evaluated by hand, a value in each range of his fits."""
    of = (torch.tensor(each, dtype=torch.float64) for each in (background, size_arcmin))
    assert float(threshold_difference(*of, torch.tensor(darker), age_years)) == pytest.approx(expected, rel=1e-3)


@given(st.floats(-3.5, 2), st.floats(1, 50))
def test_a_target_is_seen_sooner_if_larger_or_darker_than_its_background_and_by_the_young(log, size):
    level, size_arcmin, no = torch.tensor(10.0**log), torch.tensor(size), torch.tensor(False)
    threshold = threshold_difference(level, size_arcmin, no)
    assert threshold > threshold_difference(level, 1.1 * size_arcmin, no) and threshold > threshold_difference(level, size_arcmin, ~no) > 0
    assert threshold < threshold_difference(level, size_arcmin, no, age_years=60)
    # His fits meet within 4 %, over a step of 1 % of the luminance.
    assert threshold_difference(1.01 * level, size_arcmin, no) == pytest.approx(float(threshold), rel=0.05)


def test_curve_has_the_values_of_its_formula():
    shown = develop(SATURATION_CD_M2 * grey(0.0, 1.0, 99.0), 0.0)[:, 0]
    half, most = (1.055 * share ** (1 / 2.4) - 0.055 for share in (0.5, 0.99))
    assert torch.allclose(shown, torch.tensor([0.0, half, most]).expand(3, -1), atol=1e-6)
    assert torch.allclose(develop(grey(0.3), 1.0), develop(grey(0.15), 0.0)), "a step of EV is a factor of 2"


def test_a_lamp_glows_without_the_edge_of_a_disc():
    ahead = torch.tensor([[50.0], [0.0], [0.0]], dtype=torch.float64)
    shown = develop(veil(AHEAD, ahead, torch.tensor([0.4]), 40.0).expand(3, -1, -1), -1.2)[0, 100, 200:]  # as of a car 50 m ahead
    assert bool((shown.diff() <= 0).all()) and float(shown[0]) > 0.99
    # White, 254 of 255, within 0.46 deg, 8 px; a curve that clips at four times its saturation: within 1.6 deg, with a bend of 0.015.
    assert int((shown > 254 / 255).sum()) <= 10
    assert float(shown.diff().diff().abs().max()) < 0.005


@given(st.lists(st.floats(0, 1e5, width=32), min_size=2, max_size=20))
def test_brighter_is_never_shown_darker(luminances):
    shown = develop(grey(*sorted(luminances)), -1.0)[0, 0]
    assert bool((shown.diff() >= -1e-6).all()) and float(shown.min()) >= 0 and float(shown.max()) <= 1


def test_a_lamp_too_bright_for_the_display_keeps_its_hue():
    red = develop(torch.tensor([5.0, 0.1, 0.05])[:, None, None] * 1e4, 0.0)[:, 0, 0]
    assert float(red[0]) == pytest.approx(1, abs=1e-3) and float(red[1]) < 0.25 and float(red[2]) < 0.2


def test_exposure_of_even_light_shows_it_below_white():
    light = grey(*[0.02] * 50)
    ev = exposure_of(light)
    assert ev == pytest.approx(math.log2(0.02 / SATURATION_CD_M2)) and 0.5 < float(develop(light, ev)[0, 0, 0]) < 0.9
    assert math.isfinite(exposure_of(grey(0.0)))


def test_smooth_blends_stairs_and_leaves_the_rest():
    v, u = torch.meshgrid(torch.arange(40), torch.arange(60), indexing="ij")
    stairs = (u > 3 * v - 20).float().expand(3, -1, -1)
    soft = smooth(stairs)
    flat = torch.nn.functional.max_pool2d(stairs[:1], 9, 1, 4) == -torch.nn.functional.max_pool2d(-stairs[:1], 9, 1, 4)
    assert torch.allclose(soft[:1][flat], stairs[:1][flat], atol=1e-6), "far from edges nothing changes"
    assert float(soft.min()) >= 0 and float(soft.max()) <= 1 + 1e-6
    assert float(soft[:, 5:-5, 5:-5].diff(dim=-1).abs().max()) < 0.8, "no full step is left along the edge"
    even = torch.full((3, 12, 12), 0.4)
    assert torch.allclose(smooth(even), even, atol=1e-6)
