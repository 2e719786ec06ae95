"""Drops and flakes one by one against the sizes that they are drawn from, and against the medium that they stand for."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from luxloop.world.frames import View, pose_from_degrees
from luxloop.world.light.backscatter import Backscatter
from luxloop.world.light.drops import drop_luminance
from luxloop.world.scene.air import AirParams, Medium, Precipitation
from tests.world.grids import camera
from tests.world.light.test_volumetric import I_CD, uniform

VIEW = camera(320, 180)
LIT = [(uniform().headlight, pose_from_degrees((0.0, 0.6, 0.75), pitch_deg=2.0), torch.full((16,), I_CD))]
SIZES_MM = np.linspace(0, 25, 100_001)


def drawn(medium: Medium, seed: int, later: View = VIEW, exposure_s: float = 0.015) -> torch.Tensor:
    return drop_luminance(medium, VIEW, later, exposure_s, LIT, np.random.default_rng(seed))


@pytest.mark.parametrize("rate_mm_h", [1.0, 5.0, 20.0])
def test_extinction_of_rain_is_that_of_its_sizes(rate_mm_h):
    """Atlas 1953, and the integral over Marshall and Palmer's sizes; their water and its speed give the rate to 20 %."""
    rain = Precipitation.rain(rate_mm_h)
    number = 8000 * np.exp(-4.1 * rate_mm_h**-0.21 * SIZES_MM)
    sections = np.trapezoid(math.pi / 4 * SIZES_MM**2 * number, SIZES_MM) * 1e-6
    assert rain.extinction_per_m == pytest.approx(2 * sections, rel=1e-4)
    assert 1e3 * rain.extinction_per_m == pytest.approx(0.365 * rate_mm_h**0.63, rel=2e-3)
    speed = np.clip(9.65 - 10.3 * np.exp(-0.6 * SIZES_MM), 0, None)
    assert np.trapezoid(math.pi / 6 * SIZES_MM**3 * speed * number, SIZES_MM) * 3.6e-3 == pytest.approx(rate_mm_h, rel=0.2)


@pytest.mark.parametrize("rate_mm_h", [0.5, 1.0, 3.0])
def test_flakes_carry_the_water_of_their_rate(rate_mm_h):
    snow = Precipitation.snow(rate_mm_h)
    u, v, w = snow.fall
    number = snow.number_m3_mm * np.exp(-snow.slope_mm * SIZES_MM)
    water = math.pi / 6 * SIZES_MM**3 * (u - v * np.exp(-w * SIZES_MM)) * number
    assert np.trapezoid(water, SIZES_MM) * 3.6e-3 == pytest.approx(rate_mm_h, rel=0.25)
    (a, b), density = snow.width, lambda width: 0.178 * width**-0.922
    assert density(a * 2.0**b) * (a * 2.0**b) ** 3 == pytest.approx(2.0**3), "the mass of the drop that it melts into"


def test_media_add_up():
    medium = AirParams(visibility_m=200.0, rain_mm_h=10.0, snow_mm_h=1.0).medium
    parts = Medium.fog(200.0), *(each(rate) for each, rate in ((Precipitation.rain, 10.0), (Precipitation.snow, 1.0)))
    total = pytest.approx(sum(each.extinction_per_m for each in parts))
    assert (medium.extinction_per_m, medium.scattering_per_m) == (total, total)
    first_moment = sum(each.asymmetry * each.extinction_per_m for each in parts)
    assert medium.asymmetry * medium.scattering_per_m == pytest.approx(first_moment)
    assert AirParams().medium is None
    assert AirParams(visibility_m=200.0).medium == Medium.fog(200.0)


@pytest.mark.parametrize("air", [AirParams(rain_mm_h=10.0), AirParams(snow_mm_h=1.0), AirParams(visibility_m=50.0, rain_mm_h=40.0)])
def test_the_mean_of_drops_is_their_share_of_the_medium(air):
    """Energy is conserved: thirds of the image within 6 %, four standard deviations of the mean of 60 exposures; streaks leave few."""
    mean = Backscatter(replace(air.medium, drawn_only=True), VIEW).luminance(LIT, VIEW.whole, True)
    whole = Backscatter(air.medium, VIEW).luminance(LIT, VIEW.whole, True)
    assert bool((mean <= whole).all())
    found = torch.stack([drawn(air.medium, seed) for seed in range(60)]).mean(0)
    for rows in (slice(0, 60), slice(60, 120), slice(120, 180)):
        assert float(found[rows].sum() / mean[rows].sum()) == pytest.approx(1, abs=0.06)


def test_streaks_grow_with_exposure_and_speed_and_keep_their_light():
    rain = AirParams(rain_mm_h=10.0).medium
    ahead = View(VIEW.width, VIEW.height, VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy, pose_from_degrees((0.3, 0.0, 0.0)) @ VIEW.T_world_view)
    still, falls, drives = drawn(rain, 0, exposure_s=1e-6), drawn(rain, 0), drawn(rain, 0, later=ahead)
    lit = [int((each > 0).sum()) for each in (still, falls, drives)]
    assert lit[0] < 0.5 * lit[1] < 0.5 * lit[2]
    assert float(still.sum()) == pytest.approx(float(falls.sum()), rel=0.2)
    assert float(still.max()) > 2 * float(falls.max())


def test_drops_are_a_function_of_the_generator():
    rain = AirParams(rain_mm_h=10.0).medium
    assert drawn(rain, 1).equal(drawn(rain, 1))
    assert not drawn(rain, 1).equal(drawn(rain, 2))
