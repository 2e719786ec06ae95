"""A driver: continues a course by accelerator, brake and steering."""

import math
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

import numpy as np

from luxloop.world.scene.vehicle import CourseParams, VehicleParams

FASTEST_M_S: Final = 50.0
PULLS_M_S2, BRAKES_M_S2 = 3.0, 8.0
LATERAL_M_S2: Final = 5.0  # at most: below what tyres hold on a wet road
LOCK_DEG, STEERS_DEG_S = 35.0, 30.0  # of the front wheels
LARGEST_1_M: Final = 0.2  # curvature that a course may have


@dataclass(frozen=True)
class Controls:
    """throttle: 1 full acceleration, -1 full brake. steering: 1 sharpest left turn at the speed, -1 sharpest right turn."""

    throttle: float = 0.0
    steering: float = 0.0


def taken_over(course: tuple[CourseParams, ...], now_s: float) -> tuple[CourseParams, ...]:
    """A course up to now, with constant speed and curvature from then on."""
    past = tuple(takewhile(lambda each: each.time_s <= now_s, course))
    if len(past) == len(course) or not past:
        return past or (course[0].model_copy(update={"time_s": 0.0}),)
    times_s = [each.time_s for each in course]
    speed, curvature = (float(np.interp(now_s, times_s, [getattr(each, key) for each in course])) for key in ("speed_m_s", "curvature_1_m"))
    return past if past[-1].time_s == now_s else (*past, CourseParams(time_s=now_s, speed_m_s=speed, curvature_1_m=curvature))


def drive_on(params: VehicleParams, now_s: float, until_s: float, controls: Controls) -> tuple[CourseParams, ...]:
    """Entries that continue a course from now until a later time under the controls; none where nothing changes."""
    last, dt = params.course[-1], until_s - now_s
    speed = _speed(last.speed_m_s, controls.throttle, dt)
    curvature = _curvature(params.wheelbase_m, last.curvature_1_m, speed, controls.steering, dt)
    if (speed, curvature) == (last.speed_m_s, last.curvature_1_m):
        return ()
    return _then(last, now_s, CourseParams(time_s=until_s, speed_m_s=speed, curvature_1_m=curvature))


def let_go(params: VehicleParams, now_s: float) -> tuple[CourseParams, ...]:
    """Entries after which the course goes straight on at constant speed, once the wheels have turned back."""
    last = params.course[-1]
    turns_s = abs(math.degrees(math.atan(params.wheelbase_m * last.curvature_1_m))) / STEERS_DEG_S
    if turns_s == 0:
        return ()
    return _then(last, now_s, last.model_copy(update={"time_s": now_s + turns_s, "curvature_1_m": 0.0}))


def _then(last: CourseParams, now_s: float, entry: CourseParams) -> tuple[CourseParams, ...]:
    """An entry after a course that stays as its last one is until now."""
    return (last.model_copy(update={"time_s": now_s}), entry) if last.time_s < now_s else (entry,)


def _speed(before_m_s: float, throttle: float, dt: float) -> float:
    if throttle == 0:
        return before_m_s
    after = before_m_s + (PULLS_M_S2 if throttle > 0 else BRAKES_M_S2) * throttle * dt
    return round(max(0.0, min(after, max(FASTEST_M_S, before_m_s))), 6)


def _curvature(wheelbase_m: float, before_1_m: float, speed_m_s: float, steering: float, dt: float) -> float:
    most = min(math.tan(math.radians(LOCK_DEG)) / wheelbase_m, LARGEST_1_M, LATERAL_M_S2 / max(speed_m_s, 0.1) ** 2)
    angle, wanted = (math.atan(wheelbase_m * each) for each in (before_1_m, steering * most))
    turns = math.radians(STEERS_DEG_S) * dt
    after = math.tan(angle + min(max(wanted - angle, -turns), turns)) / wheelbase_m
    return round(min(max(after, -most), most), 9)
