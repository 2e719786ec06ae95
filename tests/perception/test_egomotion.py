"""Odometry and inertial sensors: the truth where they are exact, else errors of the sizes that were asked for."""

import math

import pytest
import torch
from torch import Tensor

from perception.egomotion import EXACT, Ego, SensorParams, measured
from world.frames import inverse
from world.roads.shapes import Iso8608
from world.scene.vehicle import STANDING, CourseParams, Motion, OscillationParams, VehicleParams, drive

PERIOD_S = 1 / 30


def motion_of(speed: float, curvature: float = 0.0, pitch_deg: float = 0.0, duration_s: float = 5.0) -> Motion:
    course = (CourseParams(speed_m_s=speed, curvature_1_m=curvature),)
    oscillation = OscillationParams(pitch_deg=pitch_deg, rate_hz=1.2)
    return drive(VehicleParams(course=course, oscillation=oscillation), Iso8608(roughness_class="B"), duration_s)


@pytest.fixture
def like(device: torch.device) -> Tensor:
    return torch.zeros(1, device=device)


def look(motion: Motion, step: int, like: Tensor, seed: int = 0, **errors) -> Ego:
    return measured(motion, SensorParams(**errors), step, PERIOD_S, seed, like)


def test_exact_sensors_tell_the_truth(like):
    motion = motion_of(20, 0.01)
    for step in (0, 1, 40):
        ego, now = measured(motion, EXACT, step, PERIOD_S, 0, like), motion.at(step * PERIOD_S)
        # float32 of a few centimetres and milliradians
        assert torch.allclose(ego.T_ground_body.cpu().double(), now.T_ground_body, atol=1e-7)
        assert ego.T_ground_body.device == like.device and ego.age_s == 0
        assert (float(ego.speed_m_s), float(ego.yaw_rate_rad_s)) == pytest.approx((20, 0.2))


def test_the_displacement_is_that_of_the_ground_frame_in_a_bend(like):
    motion = motion_of(20, 0.02)
    ego = look(motion, 60, like)
    before, now = (motion.at(t * PERIOD_S).T_world_ground for t in (59, 60))
    # the motion is linear between points 4 cm apart, 0.02 * 0.04^2 / 8 = 4e-6 m off the circle at either end
    assert torch.allclose(ego.way(ego.period_s).cpu().double(), inverse(before) @ now, atol=1e-5)


def test_who_stands_measures_that(like):
    ego = look(STANDING, 7, like)
    assert torch.equal(ego.T_ground_body.cpu(), torch.eye(4)) and torch.equal(ego.way(ego.period_s).cpu(), torch.eye(4))


def test_errors_have_the_sizes_that_were_asked_for():
    errors = {
        "speed_scale": 1.01,
        "speed_noise_m_s": 0.05,
        "yaw_rate_bias_deg_s": 0.3,
        "yaw_rate_noise_deg_s": 0.1,
        "heave_noise_m": 0.002,
        "pitch_bias_deg": 0.1,
        "angle_noise_deg": 0.02,
        "rate_noise_deg_s": 0.5,
    }
    like, n = torch.zeros(1), 500
    motion = motion_of(10, duration_s=n * PERIOD_S)
    seen = [(look(motion, k, like, **errors), look(motion, k, like)) for k in range(n)]
    speed, yaw_rate = (torch.stack([getattr(a, key) - getattr(b, key) for a, b in seen]) for key in ("speed_m_s", "yaw_rate_rad_s"))
    attitude, rates = (torch.stack([getattr(a, key) - getattr(b, key) for a, b in seen]) for key in ("attitude", "rates"))
    degree = math.radians(1)
    for values, mean, spread in (
        (speed, 0.1, 0.05),
        (yaw_rate, 0.3 * degree, 0.1 * degree),
        (attitude[:, 0], 0, 0.002),
        (attitude[:, 1], 0, 0.02 * degree),
        (attitude[:, 2], 0.1 * degree, 0.02 * degree),
        (rates[:, 1], 0, 0.5 * degree),
        (rates[:, 2], 0, 0.5 * degree),
    ):
        # four standard errors of a mean and of a standard deviation
        assert float(values.mean()) == pytest.approx(mean, abs=4 * spread / math.sqrt(n))
        assert float(values.std()) == pytest.approx(spread, rel=4 / math.sqrt(2 * n))
    together = torch.corrcoef(torch.stack([speed, yaw_rate, *attitude.T, *rates.T[1:]]))
    assert (together - torch.eye(len(together))).abs().max() < 4 / math.sqrt(n)


def test_a_delay_shows_what_was_measured_before(like):
    motion, noisy = motion_of(15), {"angle_noise_deg": 0.1, "speed_noise_m_s": 0.1}
    late, then = look(motion, 30, like, delay_steps=2, **noisy), look(motion, 28, like, **noisy)
    assert torch.equal(late.attitude, then.attitude) and torch.equal(late.speed_m_s, then.speed_m_s)
    assert late.age_s == pytest.approx(2 * PERIOD_S) and late.time_s == then.time_s
    assert look(motion, 1, like, delay_steps=2).time_s == 0  # before the first there is nothing


def test_noise_depends_on_step_and_seed_alone(like):
    motion = motion_of(15)
    a, b, other = (look(motion, 5, like, seed, angle_noise_deg=0.1).attitude for seed in (1, 1, 2))
    assert torch.equal(a, b) and not torch.equal(a, other)


def test_prediction_to_the_exposure_is_good_to_the_second_order(like):
    motion = motion_of(0, pitch_deg=0.2)
    bound = 0.5 * math.radians(0.2) * (2 * math.pi * 1.2) ** 2 * PERIOD_S**2
    for step in range(10, 40):
        late, now = look(motion, step, like, delay_steps=1), motion.at(step * PERIOD_S).pitch_rad
        predicted = late.after(late.age_s)
        assert predicted.age_s == 0 and predicted.time_s == pytest.approx(step * PERIOD_S)
        assert float(predicted.attitude[2]) == pytest.approx(now, abs=1.01 * bound)
