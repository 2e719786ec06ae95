"""A driver's course keeps its limits, and a motion that goes on keeps what has been."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.world.roads.base import Road
from luxloop.world.roads.shapes import Flat, Iso8608
from luxloop.world.scene.driver import (
    BRAKES_M_S2,
    FASTEST_M_S,
    LARGEST_1_M,
    LATERAL_M_S2,
    PULLS_M_S2,
    Controls,
    drive_on,
    taken_over,
)
from luxloop.world.scene.vehicle import CourseParams, Motion, VehicleParams, drive

RATE_HZ = 30.0
SIDES = st.floats(-1, 1)
CONTROLS = st.lists(st.tuples(SIDES, SIDES, st.integers(1, 20)), min_size=1, max_size=6)


def rolling(speed_m_s: float) -> VehicleParams:
    return VehicleParams(course=(CourseParams(speed_m_s=speed_m_s),), roams=True)


def driven_by(controls: list[tuple[float, float, int]], speed_m_s: float) -> VehicleParams:
    vehicle, step = rolling(speed_m_s), 0
    for throttle, steering, steps in controls:
        for _ in range(steps):
            added = drive_on(vehicle, step / RATE_HZ, (step + 1) / RATE_HZ, Controls(throttle, steering))
            vehicle, step = VehicleParams(**{**dict(vehicle), "course": (*vehicle.course, *added)}), step + 1
    return vehicle


@given(CONTROLS, st.floats(0, FASTEST_M_S))
def test_speed_acceleration_and_curvature_keep_their_limits(controls, speed_m_s):
    course = driven_by(controls, speed_m_s).course  # which is valid: times ascend
    speeds, curvatures, times = (np.array([getattr(each, key) for each in course]) for key in ("speed_m_s", "curvature_1_m", "time_s"))
    rounding = 1e-6 * RATE_HZ  # entries have six decimals
    accelerations = np.diff(speeds) / np.diff(times)
    assert speeds.min() >= 0 and speeds.max() <= FASTEST_M_S
    assert ((accelerations >= -BRAKES_M_S2 - rounding) & (accelerations <= PULLS_M_S2 + rounding)).all()
    assert abs(curvatures).max() <= LARGEST_1_M and (speeds**2 * abs(curvatures)).max() <= LATERAL_M_S2 + 1e-5


def test_a_course_that_is_taken_over_stays_as_it_is():
    course = tuple(CourseParams(time_s=t, speed_m_s=v) for t, v in ((0.0, 0.0), (2.0, 8.0), (4.0, 4.0)))
    assert taken_over(course, 3.0) == (*course[:2], CourseParams(time_s=3.0, speed_m_s=6.0))
    assert taken_over(course, 2.0) == course[:2] and taken_over(course, 9.0) == course


def on_and_on(vehicle: VehicleParams, road: Road, steps: int) -> tuple[Motion, float, float]:
    """A motion step by step as courses grow; the greatest jump in m of the body, and of the ground, at the moment after each change."""
    motion, body_m, ground_m = drive(vehicle.model_copy(update={"course": vehicle.course[:1]}), road, 3 / RATE_HZ), 0.0, 0.0
    for step in range(1, steps):
        now_s = step / RATE_HZ
        course = tuple(each for each in vehicle.course if each.time_s <= now_s + 1.01 / RATE_HZ)
        before, motion = motion, drive(vehicle.model_copy(update={"course": course}), road, (step + 3) / RATE_HZ, motion)
        known = int(np.searchsorted(before.times_s, now_s - 1e-9))
        assert np.array_equal(motion.states[:known], before.states[:known])
        then, now = (each.at(float(motion.times_s[known + 1])) for each in (before, motion))
        body_m = max(body_m, float((then.T_world_body - now.T_world_body).abs().max()))
        ground_m = max(ground_m, abs(then.ground_m - now.ground_m))
    return motion, body_m, ground_m


@settings(max_examples=20)
@given(CONTROLS, st.floats(1, 40), st.sampled_from([Flat(), Iso8608(roughness_class="C")]))
def test_the_past_stays_to_the_bit_and_nothing_jumps(controls, speed_m_s, road):
    vehicle = driven_by([(0.0, 0.0, 2), *controls], speed_m_s)
    steps = 2 + sum(each for *_, each in controls)
    motion, body_m, ground_m = on_and_on(vehicle, road, steps)
    assert body_m < 1e-3 and ground_m < 1e-3
    whole = drive(vehicle, road, (steps + 2) / RATE_HZ)
    x, y, yaw = (abs(motion.states[:, k] - whole.states[:, k]).max() for k in range(3))
    assert max(x, y, yaw) < 1e-9  # sums in another order
    late = motion.times_s <= (steps - 1) / RATE_HZ
    assert abs(motion.states[late, 13] + motion.states[late, 8] - whole.states[late, 13] - whole.states[late, 8]).max() < 2e-4
    # rad, of the body's pitch in the world: the acceleration of the moment before a change looks a moment ahead
