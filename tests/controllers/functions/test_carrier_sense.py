"""Carrier sense by light: cars on an ideal road, of which each knows only the sum of all light, its noise included."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from luxloop.controllers.functions.carrier_sense import CarrierSenseParams, CarrierState, stretch_contrast
from luxloop.controllers.functions.zone import box_region
from luxloop.controllers.situation import CameraImage
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.frames import pose_from_degrees
from tests.controllers import situations

SENSE = CarrierSenseParams(turn_s=1.5)
RATE_HZ, START, OTHER_SEED = 30.0, 30, 2**62
VIEW = camera_view(CameraParams(width_px=320, height_px=180))
DARK = CameraImage(0.0, VIEW, torch.zeros(180, 320))


def share(
    seed: int,
    wants: tuple[Callable[[int], bool], ...] = (lambda step: step >= START,) * 2,
    base: Callable[[int], float] = lambda step: 0.04,
    steps: int = 150,
    latency: int = 0,
    loss: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Whose turn it is, and whose light is on the road, `[steps, cars]` bool.

    Light of a car adds 0.25 cd/m^2, and noise has 0.002, as in the shipped scenario.
    """
    random, states, turns, light = np.random.default_rng(seed), [CarrierState() for _ in wants], [], []
    for step in range(steps):
        cars = [situations.now(time_s=step / RATE_HZ, rate_hz=RATE_HZ, seed=seed + k * OTHER_SEED) for k in range(len(wants))]
        light.append([SENSE.lights(state, now, now.time_s) for state, now in zip(states, cars, strict=True)])
        turns.append([state.turn == "draws" for state in states])
        for k, now in enumerate(cars):
            if step >= latency and random.random() >= loss:
                seen = replace(DARK, time_s=(step - latency) / RATE_HZ)
                contrast = base(step - latency) + 0.25 * sum(light[step - latency]) + 0.002 * random.standard_normal()
                states[k] = SENSE.step(states[k], replace(now, seen=seen), contrast, wants[k](step))
    return np.array(turns), np.array(light)


def agreed(turns: np.ndarray) -> int:
    """Steps from the first in which both may draw to ten steps with one car alone."""
    one = turns[START + 1 :].sum(1) == 1
    return next(k for k in range(len(one)) if one[k : k + 10].all())


@pytest.mark.parametrize(("time_s", "wanted", "turn"), [(1.0, True, "draws"), (1.6, True, "waits"), (1.0, False, "idle")])
def test_a_turn_ends_with_its_time_or_the_wish_also_where_the_stretch_is_out_of_the_image(time_s, wanted, turn):
    now = replace(situations.now(time_s=time_s, rate_hz=RATE_HZ), seen=DARK)
    assert SENSE.step(CarrierState("draws", since_s=0.0), now, math.nan, wanted).turn == turn


def test_a_lone_car_draws_in_the_first_frame_after_its_wish():
    turns, light = share(0, wants=(lambda step: step >= START,))
    assert not turns[: START + 1].any()
    assert turns[START + 1 : START + 45].all()
    assert light[START + 1 : START + 45].mean() == pytest.approx(7 / 8, abs=0.03)


def test_nobody_draws_before_it_has_listened_for_two_rounds_of_pauses():
    turns, _ = share(0, wants=(lambda step: True,))
    assert turns[:, 0].argmax() == 2 * SENSE.pause_every


@pytest.mark.parametrize(("latency", "loss", "worst"), [(0, 0.0, 16), (0, 0.1, 16), (1, 0.1, 40), (2, 0.1, 60)])
def test_of_two_that_begin_together_one_soon_draws_alone(latency, loss, worst):
    """worst: steps to agreement, from 60 seeds other than these."""
    runs = [share(1000 + seed, latency=latency, loss=loss)[0] for seed in range(10)]
    assert max(map(agreed, runs)) <= worst
    assert np.mean([turns.all(1).mean() for turns in runs]) < 0.06
    assert all(turns[:, k].any() for turns in runs for k in (0, 1))


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_who_comes_later_waits_for_its_turn(loss):
    for seed in range(10):
        turns, light = share(seed, (lambda step: step >= START, lambda step: step >= START + 20), loss=loss)
        assert not light.all(1).any()
        assert turns[START + 46 :, 1].any()


def test_steady_light_is_no_carrier_though_it_grows():
    """Low beams that are switched on, as bright as a drawing."""
    turns, _ = share(0, wants=(lambda step: step >= START,), base=lambda step: 0.04 if step < START else 0.29)
    memory = 4 * SENSE.pause_every
    assert not turns[: START + memory].any()
    assert turns[START + memory + 10, 0]


def test_frames_from_before_a_turn_say_nothing_about_it():
    now = situations.now(time_s=2.0, seen=replace(DARK, time_s=1.9))
    state = CarrierState("draws", since_s=1.95, silent=(0.04,) * 16)
    assert SENSE.step(state, now, 9.0, True) == state
    assert SENSE.step(state, now, math.nan, True) == state


def test_contrast_is_what_a_rectangle_has_over_its_surroundings():
    T, half = pose_from_degrees((15.0, 1.0, 0.0), yaw_deg=20.0), torch.tensor([1.5, 1.0, 0.0], dtype=torch.float64)
    lit = 0.7 + 0.25 * box_region(VIEW, T, -half, half)
    assert stretch_contrast(replace(DARK, luminance=lit), T, 3.0, 2.0) == pytest.approx(0.25, abs=1e-6)
    assert math.isnan(stretch_contrast(DARK, pose_from_degrees((15.0, 30.0, 0.0)), 3.0, 2.0))
    assert math.isnan(stretch_contrast(DARK, pose_from_degrees((-15.0, 0.0, 0.0)), 3.0, 2.0))
