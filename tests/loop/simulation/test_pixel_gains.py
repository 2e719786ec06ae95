"""Worn pixels: codes, what a camera tells of gains, and compensation."""

import csv

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from luxloop import Simulation, load, run
from luxloop.controllers.pixels.compensation import Compensation
from luxloop.perception.pixel_gains import PERIOD, WIDE, PixelGains, code, decide, swing
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.description import load_lamp
from tests.refusal import refusal

SMALL = (
    "renderer=raycast",
    "steps=128",
    "pixel_gains.update_s=4.2",
    "disturbances.wear={ dead = 0.0, aged = 0.0, dead_pixels = [60, 70] }",
)
STANDING = (*SMALL, "vehicle.course=[{ speed_m_s = 0.0 }]", "road={ kind = 'flat' }")


def light() -> Headlight:
    return load_lamp("hd84", "left").modules[0].headlight


@given(st.integers(0, 10_000), st.floats(0.01, 0.5))
def test_both_frames_have_the_mean_of_the_planned_light(step, share):
    u = torch.linspace(0, 1, 84)
    first, second = swing(u, code(light(), 0, step), share)
    torch.testing.assert_close((first + second) / 2, u)
    assert bool(((first >= 0) & (first <= 1) & (second >= 0) & (second <= 1)).all())


def test_neighbours_and_lamps_have_orthogonal_codes():
    both = torch.stack([torch.cat([code(light(), module, step) for module in range(2)]) for step in range(PERIOD)])  # [steps, 2 n_p]
    block = both.view(PERIOD, 2, 3, 28)[..., 10 : 10 + WIDE].flatten(1)
    torch.testing.assert_close(block.T @ block, PERIOD * torch.eye(block.shape[1]))


def found(*overrides: str) -> list[list[int]]:
    simulation = Simulation.prepare(load("worn_pixels", overrides))
    state = simulation.start()
    for _ in range(simulation.scenario.steps):
        state, _ = simulation.step(state)
    assert state.gains is not None
    return [torch.nonzero(each.worn)[:, 0].tolist() for each in state.gains.gains]


def test_a_driving_car_finds_dead_pixels_and_no_others():
    assert found(*SMALL, "seed=1") == [[60, 70], [60, 70]]


def test_new_lamps_have_no_worn_pixels():
    assert found(*STANDING, "disturbances.wear.dead_pixels=[]") == [[], []]


def test_a_pixel_is_judged_by_the_light_that_it_had():
    headlight, one = light(), torch.ones(84)
    gains = PixelGains(1e4 * one, 1e4 * one, 0.5e4 * one, one, one)
    gains.response[70] = 0.0
    found = decide(headlight, gains)
    assert torch.nonzero(found.worn)[:, 0].tolist() == [70]
    assert bool((found.std[60:] < 0.15).all())


def test_the_two_frames_of_a_step_have_the_mean_of_the_planned_light():
    coded = Simulation.prepare(load("worn_pixels", SMALL))
    first, second = coded.at(0).exposures
    for module, a, b in zip(coded.modules, first.lights, second.lights, strict=True):
        torch.testing.assert_close((a.u + b.u) / 2, module.beam("low"))
        assert not torch.equal(a.u, b.u)


def test_others_take_over_within_their_limits():
    headlight, gains = light(), torch.ones(84)
    u = torch.full((84,), 0.5)
    u[0] = 0.0
    torch.testing.assert_close(Compensation(headlight, gains).utilisation(u), u, rtol=0, atol=1e-3)
    gains[70], gains[30] = 0.0, 0.6
    shown = Compensation(headlight, gains).utilisation(u)
    wanted = headlight.light_texture(u)
    before, after = ((headlight.light_texture(each * gains) - wanted).square().sum() for each in (u, shown))
    assert after < 0.7 * before  # neighbours overlap by a fifth at a pixel's centre, so that much of a dead one cannot be replaced
    assert shown[30] == pytest.approx(0.5 / 0.6, rel=0.05)  # its own light is closest
    assert shown[0] == 0 and bool(((shown >= 0) & (shown <= 1)).all())


def test_the_recording_of_a_standing_car_lists_its_dead_pixels(tmp_path):
    result = run("worn_pixels", tmp_path / "run", overrides=STANDING, video=False, report=False)
    assert result.summary["pixels"]["left matrix"]["worn"] == 2
    with (tmp_path / "run" / "pixels.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(each["module"], each["row"], each["column"]) for each in rows if float(each["gain"]) < 1} == {
        (f"{side} matrix", "2", column) for side in ("left", "right") for column in ("4", "14")
    }


def test_what_else_alternates_within_a_step_is_refused():
    with refusal("functions.symbol.controller: measures a symbol by frames with and without it"):
        load("snowflake", ["pixel_gains.swing=0.2"])
    with refusal("lighting.power_limit: limits the planned light"):
        load("worn_pixels", ["lighting.power_limit=0.5"])
    with refusal("headlight.rate_hz: the lamps draw anew within a frame"):
        load("worn_pixels", ["headlight.rate_hz=240", "camera.exposure_s=0.004"])
    with refusal("camera.exposure_s: 0.02 s is longer than half a control period"):
        load("worn_pixels", ["camera.exposure_s=0.02"])
