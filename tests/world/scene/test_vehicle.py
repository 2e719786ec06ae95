"""The vehicle against closed forms: straight and circular courses, and the answers of damped oscillators."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike
from pydantic import ValidationError

from luxloop.world.frames import transform
from luxloop.world.roads.base import Floats, MeshGrid
from luxloop.world.roads.shapes import Flat, GradeParams, Profile
from luxloop.world.scene.vehicle import COLUMNS, STANDING, CourseParams, Motion, SuspensionParams, VehicleParams, drive


@dataclass(frozen=True)
class Wavy:
    """A plane with a wave along it."""

    slope: float = 0.0
    crossfall: float = 0.0
    amplitude_m: float = 0.0
    length_m: float = 1.0

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        return self.slope * x + self.crossfall * y + self.amplitude_m * np.sin(2 * np.pi * x / self.length_m)

    def grid(self) -> MeshGrid:
        return MeshGrid()


def driven(*course: tuple[float, float, float], road=None, duration_s: float = 10.0, **keys) -> Motion:
    entries = tuple(CourseParams(time_s=t, speed_m_s=v, curvature_1_m=k) for t, v, k in course)
    return drive(VehicleParams(course=entries, **keys), road or Flat(), duration_s)


def test_who_stands_stays_at_the_origin_to_the_bit():
    for t in (-1.0, 0.0, 1000.0):
        state = STANDING.at(t)
        assert torch.equal(state.T_world_body, torch.eye(4, dtype=torch.float64)) and state.speed_m_s == 0


def test_the_rear_axle_goes_round_a_circle_to_the_left():
    motion = driven((0, 10, 1 / 50))
    rear = torch.tensor([[motion.rear_x_m], [0.0], [0.0]], dtype=torch.float64)
    for t in (1.0, 5.0):
        state, angle = motion.at(t), 10 * t / 50
        x, y, z = transform(state.T_world_ground, rear)[:, 0].tolist()
        # exact up to the linear interpolation between arcs of 2 cm: 0.02^2 / 8 / 50
        assert (x, y, z) == pytest.approx((motion.rear_x_m + 50 * math.sin(angle), 50 * (1 - math.cos(angle)), 0), abs=2e-6)
        assert (state.yaw_rate_rad_s, state.lateral_m_s2) == pytest.approx((0.2, 2.0))
        heading = state.T_world_ground[:2, 0]
        assert heading.tolist() == pytest.approx([math.cos(angle), math.sin(angle)], abs=1e-6)


def test_a_brake_dives_as_a_damped_oscillator_does():
    rate, damping, dive = 1.4, 0.3, 0.2
    spring = SuspensionParams(pitch_hz=rate, damping=damping, dive_deg_per_m_s2=dive)
    motion = driven((0, 30, 0), (1, 30, 0), (7, 0, 0), suspension=spring, simulation_hz=2000)
    omega, final = 2 * math.pi * rate, math.radians(5 * dive)
    ringing = omega * math.sqrt(1 - damping**2)
    for t in np.linspace(0.05, 5.5, 40):
        decayed = math.exp(-damping * omega * t)
        expected = final * (1 - decayed * (math.cos(ringing * t) + damping * omega / ringing * math.sin(ringing * t)))
        # the step of the acceleration is spread over two intervals of 0.5 ms, in which pitch moves by omega * 1 ms = 1 % at most
        assert motion.at(1 + t).pitch_rad == pytest.approx(expected, abs=0.01 * final)


def test_the_body_leans_out_of_a_bend():
    state = driven((0, 20, 0.01)).at(9.0)  # to the left, 4 m/s^2
    assert state.roll_rad == pytest.approx(math.radians(4 * 0.4), rel=1e-3)
    left = transform(state.T_ground_body, torch.tensor([[0.0], [1.0], [0.0]], dtype=torch.float64))
    assert left[2] > 0


def test_on_a_plane_the_ground_and_the_body_lie_parallel_to_it():
    motion = driven((0, 10, 0), road=Wavy(slope=0.03, crossfall=0.02))
    state = motion.at(8.0)
    assert state.slope_rad == pytest.approx(-math.atan(0.03), abs=1e-9)
    assert state.climb_m_s == pytest.approx(0.3, abs=1e-6)
    ahead = transform(state.T_world_ground, torch.tensor([[20.0], [0.0], [0.0]], dtype=torch.float64))[:, 0]
    # from the frame's origin, whose height is that of the plane a little behind it: x is along the slope, 3.6 m (1 - cos)
    assert float(ahead[2]) == pytest.approx(0.03 * float(ahead[0]), abs=1e-4)
    # the plane runs away from the body at a steady rate, which leaves a damped oscillator behind by nothing; springs take the slope for
    # its angle, atan(0.03) = 0.03 - 9e-6
    assert state.pitch_rad == pytest.approx(0, abs=1e-5) and state.roll_rad == pytest.approx(0.02, abs=1e-9)
    assert state.heave_m == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("length_m", [40.0, 15.0, 8.0], ids=["below", "near", "above resonance"])
def test_a_wavy_road_lifts_the_body_by_the_transmissibility(length_m):
    damping, rate = 0.35, 1.2
    motion = driven((0, 15, 0), road=Wavy(amplitude_m=0.02, length_m=length_m), duration_s=30)
    dt = motion.times_s[1] - motion.times_s[0]
    heave = np.cumsum(motion.states[:, COLUMNS.index("rise_m_s")])[(motion.times_s > 20) & (motion.times_s < 29)] * dt
    r = 15 / length_m / rate
    transmissibility = abs(complex(1, 2 * damping * r) / complex(1 - r**2, 2 * damping * r))
    mean_of_axles = abs(math.cos(math.pi * 2.8 / length_m))
    # rms over 9 s holds whole waves but for one: 1 % of the squares for the longest
    assert np.sqrt(2 * heave.var()) == pytest.approx(0.02 * transmissibility * mean_of_axles, rel=0.01)


def test_rates_are_the_slopes_of_the_attitude():
    motion = driven((0, 15, 0), road=Wavy(amplitude_m=0.02, length_m=9.0, crossfall=0.01))
    h, pivot = 1e-3, torch.tensor([[motion.pivot_x_m], [0.0], [0.0]], dtype=torch.float64)
    for t in (1.0, 2.2, 5.7):
        before, now, after = motion.at(t - h), motion.at(t), motion.at(t + h)
        for value, rate in (
            (lambda each: each.ground_m, now.climb_m_s),
            (lambda each: each.slope_rad, now.bend_rad_s),
            (lambda each, at=pivot: float(transform(each.T_world_body, at)[2]), now.rise_m_s),
            (lambda each: each.slope_rad + each.pitch_rad, now.pitch_rate_rad_s),
            (lambda each: each.roll_rad, now.roll_rate_rad_s),
        ):
            slope = (value(after) - value(before)) / (2 * h)
            assert rate == pytest.approx(slope, abs=1e-3)  # of 0.2; both are differences over 2 ms, one shifted by up to 1 ms


@pytest.mark.parametrize("length_m", [5.0, 10.0, 20.0, 50.0])
def test_the_ground_follows_long_waves_alone(length_m):
    motion = driven((0, 10, 0), road=Wavy(amplitude_m=0.02, length_m=length_m), duration_s=12)
    t = motion.times_s[(motion.times_s > 1) & (motion.times_s < 11)][::10]  # whole waves
    rear, slope = (np.array([value(motion.at(each)) for each in t]) for value in (_rear_m, lambda state: state.slope_rad))

    def left(window_m: float) -> float:  # of a wave by a raised cosine, its Fourier transform
        w = window_m / length_m
        return 0.5 if w == 1 else math.sin(math.pi * w) / (math.pi * w * (1 - w**2))

    # sampled at 5 cm, by which sums differ from integrals in the sixth digit
    assert np.sqrt(2 * rear.var()) == pytest.approx(0.02 * abs(left(10)), abs=2e-6)
    assert np.sqrt(2 * slope.var()) == pytest.approx(0.02 * 2 * math.pi / length_m * abs(left(50)), abs=2e-6)


def _rear_m(state) -> float:
    """Height of the ground under the rear axle."""
    return float(transform(state.T_world_ground, torch.tensor([[-3.6], [0.0], [0.0]], dtype=torch.float64))[2])


def test_over_a_crest_the_ground_touches_the_road_under_the_rear_axle():
    grades = (GradeParams(x_m=20, percent=5, curve_m=40), GradeParams(x_m=120, percent=-5, curve_m=100))
    road = Profile(grades=grades)
    motion = driven((0, 20, 0), road=road, duration_s=14)
    for t in np.linspace(0.5, 13, 30):
        state = motion.at(float(t))
        x, _, z = transform(state.T_world_ground, torch.tensor([[-3.6], [0.0], [0.0]], dtype=torch.float64))[:, 0].tolist()
        grade = float(road.z(x + 0.5, 0.0) - road.z(x - 0.5, 0.0))
        # a raised cosine of 10 m has a variance of 3.3 m^2, half of which times 1 / 800 m it lies below; one of 50 m tells the mean grade
        # over some 20 m, 1 / 800 m apart
        assert z == pytest.approx(float(road.z(x, 0.0)), abs=2.1e-3)
        assert math.tan(-state.slope_rad) == pytest.approx(grade, abs=0.008)
    level, up, down = (motion.at(t) for t in (0.0, 5.0, 13.5))  # 5 s: 96 m, half of the window before the crest
    assert [state.slope_rad for state in (level, down)] == pytest.approx([0.0, math.atan(0.05)], abs=2e-4)
    assert -0.05 < up.slope_rad < -0.04


def test_times_must_ascend():
    with pytest.raises(ValidationError, match=r"course\n.*time_s must ascend"):
        driven((1, 20, 0), (1, 10, 0))


def test_braking_takes_the_way_that_it_should():
    motion = driven((0, 20, 0), (1, 20, 0), (5, 0, 0))
    assert motion.at(9.0).T_world_ground[0, 3] == pytest.approx(20 + 40, abs=1e-6)
    assert motion.at(3.0).acceleration_m_s2 == pytest.approx(-5)
