"""Odometry and inertial sensors: the truth where they are exact, else errors of the sizes that were asked for."""

import math

import pytest
import torch
from torch import Tensor

from luxloop.perception.egomotion import Ego, Sample, Sensor, ego_of, recent
from luxloop.perception.sensors import SensorParams, Sensors
from luxloop.world.frames import inverse
from luxloop.world.roads.shapes import Flat, Iso8608
from luxloop.world.scene.vehicle import STANDING, CourseParams, Motion, OscillationParams, VehicleParams, drive

PERIOD_S = 1 / 30
CAR = VehicleParams(course=(CourseParams(speed_m_s=0.0),))
LIKE = torch.zeros(1)
ALL_S = 1.5  # by which a test's samples have arrived


def motion_of(speed: float, curvature: float = 0.0, pitch_deg: float = 0.0, duration_s: float = 5.0) -> Motion:
    course = (CourseParams(speed_m_s=speed, curvature_1_m=curvature),)
    oscillation = OscillationParams(pitch_deg=pitch_deg, rate_hz=1.2)
    return drive(VehicleParams(course=course, oscillation=oscillation), Iso8608(roughness_class="B"), duration_s)


def known(motion: Motion, sensors: SensorParams, time_s: float, seed: int, like: Tensor) -> Ego:
    """By samples that came one after the other in a second and a half."""
    source = Sensors(motion, sensors, PERIOD_S, seed)
    samples = recent(source.newest(max(time_s - ALL_S, 0.0), like), source.arriving(max(time_s - ALL_S, 0.0), time_s, like))
    ego = ego_of(samples, CAR, time_s, PERIOD_S)
    assert ego is not None
    return ego


@pytest.fixture
def like(device: torch.device) -> Tensor:
    return torch.zeros(1, device=device)


UNIT = ("wheels", "gyro", "attitude")


def look(motion: Motion, step: int, like: Tensor, seed: int = 0, fitted: tuple[Sensor, ...] = UNIT, **sensors) -> Ego:
    return known(motion, SensorParams(fitted=fitted, **sensors), step * PERIOD_S, seed, like)


def test_exact_sensors_tell_the_truth(like):
    motion = motion_of(20, 0.01)
    for step in (0, 1, 40):
        ego, now = look(motion, step, like), motion.at(step * PERIOD_S)
        # float32 of a few centimetres and milliradians, and of the pivot 2.2 m behind
        assert torch.allclose(ego.T_ground_body.cpu().double(), now.T_ground_body, atol=3e-7)
        assert ego.T_ground_body.device == like.device and ego.attitude_s == ego.rates_s == ego.speed_s == ego.time_s
        assert (float(ego.speed_m_s), float(ego.yaw_rate_rad_s)) == pytest.approx((20, 0.2))


def test_the_displacement_is_that_of_the_ground_frame_in_a_bend(like):
    motion = motion_of(20, 0.02)
    (before, was), (ego, now) = ((look(motion, step, like), motion.at(step * PERIOD_S)) for step in (59, 60))
    moved = inverse(before.T_level_ground) @ ego.way(ego.on_s) @ ego.T_level_ground
    # the motion is linear between points 4 cm apart, 0.02 * 0.04^2 / 8 = 4e-6 m off the circle at either end
    assert torch.allclose(moved.cpu().double(), inverse(was.T_world_ground) @ now.T_world_ground, atol=1e-5)


def test_the_ground_is_predicted_as_the_body_over_it(like):
    motion = motion_of(20)
    ego, later = look(motion, 60, like).at(61 * PERIOD_S), motion.at(61 * PERIOD_S)
    # on a road of class B the body swings by some 5 mm and mrad at 1.5 Hz: its rates change by 0.5 a second, 0.5 / 2 (33 ms)^2 is 0.3
    assert torch.allclose(ego.T_ground_body.cpu().double(), later.T_ground_body, atol=5e-4)
    assert torch.allclose(ego.ground[:2].cpu().double(), ego.ground.new_tensor([later.ground_m, later.slope_rad]).cpu().double(), atol=5e-4)


def test_who_stands_measures_that(like):
    ego = look(STANDING, 7, like)
    assert torch.equal(ego.T_ground_body.cpu(), torch.eye(4)) and torch.equal(ego.way(ego.on_s).cpu(), torch.eye(4))


def test_errors_have_the_sizes_that_were_asked_for():
    errors = {
        "wheels": {"scale": 1.01, "noise_m_s": 0.05},
        "gyro": {"bias_deg_s": 0.4, "yaw_bias_deg_s": 0.3, "yaw_noise_deg_s": 0.1, "noise_deg_s": 0.5},
        "attitude": {"heave_noise_m": 0.002, "pitch_bias_deg": 0.1, "noise_deg": 0.02},
    }
    like, n = torch.zeros(1), 40
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
        (rates[:, 1], 0.4 * degree, 0.5 * degree),
        (rates[:, 2], 0.4 * degree, 0.5 * degree),
    ):
        # four standard errors of a mean and of a standard deviation
        assert float(values.mean()) == pytest.approx(mean, abs=4 * spread / math.sqrt(n))
        assert float(values.std()) == pytest.approx(spread, rel=4 / math.sqrt(2 * n))
    together = torch.corrcoef(torch.stack([speed, yaw_rate, *attitude.T, *rates.T[1:]]))
    assert (together - torch.eye(len(together))).abs().max() < 4 / math.sqrt(n)


def test_a_delay_shows_what_was_measured_before(like):
    motion, noise = motion_of(15), {"wheels": {"noise_m_s": 0.1}, "attitude": {"noise_deg": 0.1}, "gyro": {}}
    late = look(motion, 30, like, **{name: {**each, "delay_s": 2 * PERIOD_S} for name, each in noise.items()})
    then, other = look(motion, 28, like, **noise), look(motion, 28, like, seed=1, **noise)
    assert torch.equal(then.attitude, look(motion, 28, like, **noise).attitude) and not torch.equal(then.attitude, other.attitude)
    assert torch.equal(late.attitude, then.attitude) and torch.equal(late.speed_m_s, then.speed_m_s)
    assert (late.attitude_s, late.rates_s, late.speed_s) == (then.attitude_s, then.rates_s, then.speed_s)
    assert late.time_s == pytest.approx(then.time_s + 2 * PERIOD_S)
    assert look(motion, 1, like, attitude={"delay_s": 0.06}).attitude_s == 0  # the sample of time 0 is there at once
    motion = motion_of(15, pitch_deg=0.5)
    ego = look(motion, 60, like, gyro={"delay_s": 0.1})
    assert torch.equal(ego.rates[1:], look(motion, 57, like).rates[1:]) and torch.equal(ego.attitude, look(motion, 60, like).attitude)
    assert (ego.rates_s, ego.attitude_s) == pytest.approx((1.9, 2.0))


def test_a_slow_sensor_holds_its_last_sample(like):
    motion = motion_of(15, pitch_deg=0.5)
    egos = [look(motion, step, like, attitude={"rate_hz": 10, "delay_s": 0.02}) for step in range(30, 37)]
    assert [ego.attitude_s for ego in egos] == pytest.approx([0.9, 1.0, 1.0, 1.0, 1.1, 1.1, 1.1])
    assert torch.equal(egos[1].attitude, egos[3].attitude) and not torch.equal(egos[3].attitude, egos[4].attitude)
    assert len({float(ego.rates[2]) for ego in egos}) == len(egos), "the gyro goes on"


def test_a_quick_sensor_sends_every_sample_once():
    sensors = Sensors(motion_of(15), SensorParams(fitted=("gyro",), gyro={"rate_hz": 100, "delay_s": 0.004}), PERIOD_S, 0)
    spans = [(k / 60, (k + 1) / 60) for k in range(30)]
    came = [(sample, until) for since, until in spans for sample in sensors.arriving(since, until, LIKE)]
    assert [sample.measured_s for sample, _ in came] == pytest.approx([k / 100 for k in range(1, 50)])
    assert all(until - 1 / 60 < sample.arrived_s <= until + 1e-9 for sample, until in came)


@pytest.mark.parametrize(
    ("sensor", "key", "step"),
    [("wheels", "m_s", 0.07), ("gyro", "deg_s", 0.1), ("accelerometer", "m_s2", 0.02), ("suspension", "m", 0.002)],
)
def test_values_are_the_nearest_step_to_what_is_measured(sensor, key, step):
    motion, unit = motion_of(15, pitch_deg=0.5), math.radians(step) if key == "deg_s" else step
    fitted = [SensorParams(fitted=(sensor,), **{sensor: table}) for table in ({}, {f"resolution_{key}": step})]
    exact, coarse = (torch.stack([found.values for found in Sensors(motion, each, PERIOD_S, 0).arriving(0, 1, LIKE)]) for each in fitted)
    assert torch.allclose(coarse, unit * (exact / unit).round(), atol=1e-6) and not torch.allclose(coarse, exact, atol=1e-6)


@pytest.mark.parametrize(("sensor", "key", "bias"), [("accelerometer", "bias_m_s2", 0.1), ("suspension", "bias_m", 0.004)])
def test_all_values_of_a_sensor_have_its_bias(sensor, key, bias):
    fitted = [SensorParams(fitted=(sensor,), **{sensor: table}) for table in ({}, {key: bias})]
    exact, biased = (Sensors(motion_of(15, pitch_deg=0.5), each, PERIOD_S, 0).newest(0.5, LIKE)[0].values for each in fitted)
    assert torch.allclose(biased - exact, torch.tensor(bias), atol=1e-6)


def test_an_inertial_unit_is_fitted_where_its_table_is_given_and_no_choice_is():
    assert "attitude" not in SensorParams().present and "attitude" in SensorParams(attitude={}).present
    assert SensorParams(attitude={}, fitted=("gyro",)).present == ("gyro",)


def test_springs_tell_the_attitude_without_a_unit(like):
    course = (CourseParams(speed_m_s=20.0), CourseParams(time_s=2.0, speed_m_s=10.0, curvature_1_m=0.01))
    motion, fitted = drive(VehicleParams(course=course), Flat(), 3.0), ("wheels", "gyro", "suspension")
    ego, unit = look(motion, 45, like, fitted=fitted), look(motion, 45, like)
    assert torch.allclose(ego.attitude, unit.attitude, atol=1e-7) and float(unit.attitude[1:].abs().min()) > 1e-3
    assert ego.rates[0].isnan() and torch.equal(ego.rates[1:], unit.rates[1:])


def test_an_accelerometer_tells_the_speed_that_wheels_tell_late(like):
    course = (CourseParams(speed_m_s=20.0), CourseParams(time_s=2.0, speed_m_s=10.0))
    motion = drive(VehicleParams(course=course), Flat(), 3.0)
    wheels, fitted = {"delay_s": 0.1}, ("wheels", "accelerometer")
    now = look(motion, 45, like).speed_m_s
    assert float(look(motion, 45, like, wheels=wheels, fitted=fitted).speed_m_s - now) == pytest.approx(0, abs=1e-5)
    assert float(look(motion, 45, like, wheels=wheels).speed_m_s - now) == pytest.approx(0.5, abs=1e-5)


def test_samples_are_in_the_order_of_measurement_and_the_newest_of_each_sensor_before_the_last_two_seconds_is_kept():
    oldest, old, early, late = (Sample("gyro", at_s, 4.0, torch.zeros(3)) for at_s in (0.1, 0.2, 1.5, 3.4))
    wheels = Sample("wheels", 0.1, 0.2, torch.tensor([9.0, 11.0]))
    assert {*recent((), [oldest, old, early, late, wheels])} == {wheels, old, early, late}
    assert recent(recent((), [wheels, late]), [early, old]) == recent((), [wheels, old, early, late]) == (wheels, old, early, late)
    assert ego_of((late,), CAR, 1.0, PERIOD_S) is None, "nobody knows whether it moves"
    alone = ego_of((wheels,), None, 1.0, PERIOD_S)
    assert alone is not None and float(alone.speed_m_s) == 10 and alone.speed_s == 0.1
    assert float(alone.yaw_rate_rad_s) == 0 and bool(alone.attitude.isnan().all() and alone.rates.isnan().all())


def test_the_motion_since_a_time_is_that_of_each_measurement(like):
    motion = motion_of(15, pitch_deg=0.5)
    sensors = {name: {"rate_hz": 100, "delay_s": delay_s} for name, delay_s in (("wheels", 0.01), ("gyro", 0.005), ("attitude", 0.01))}
    ego = look(motion, 30, like, **sensors)
    since = list(ego.since(0.905, 0.99))
    assert [time_s for time_s, _ in since] == pytest.approx([0.91 + 0.01 * k for k in range(9)])
    for time_s, samples in since:
        each = ego_of(samples, CAR, time_s)
        assert each is not None and each.attitude_s == each.rates_s == time_s
        assert float(each.attitude[2]) == pytest.approx(motion.at(time_s).pitch_rad, abs=1e-7)


def test_prediction_to_the_exposure_is_good_to_the_second_order(like):
    motion = motion_of(0, pitch_deg=0.2)
    bound = 0.5 * math.radians(0.2) * (2 * math.pi * 1.2) ** 2 * PERIOD_S**2
    for step in range(10, 40):
        late, now = (
            look(motion, step, like, attitude={"delay_s": PERIOD_S}, gyro={"delay_s": PERIOD_S}),
            motion.at(step * PERIOD_S).pitch_rad,
        )
        predicted = late.at(late.time_s)
        assert late.attitude_s == pytest.approx((step - 1) * PERIOD_S) and predicted.attitude_s == late.time_s
        assert float(predicted.attitude[2]) == pytest.approx(now, abs=1.01 * bound)
