"""The vehicle in motion: a course, the ground that follows the road below it, and a body on springs that road and acceleration shake.

Three frames, all x forward, y left, z up, which coincide while the vehicle stands, the origin below the middle of its lamps: the *world*;
the *ground*, which drives along the course on the plane through the low-passed road under the rear axle, x along its slope; and the *body*
on its springs, which lamps and camera are fixed to.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Final, Self

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from world.budget import afford
from world.frames import pose, rotation
from world.params import Params
from world.roads.base import Floats, Road, smoothstep

COLUMNS: Final = (
    *("x_m", "y_m", "yaw_rad", "speed_m_s", "yaw_rate_rad_s", "acceleration_m_s2", "lateral_m_s2", "ground_m", "slope_rad"),
    *("climb_m_s", "bend_rad_s"),
    *("heave_m", "roll_rad", "pitch_rad", "rise_m_s", "roll_rate_rad_s", "pitch_rate_rad_s"),
    *("travel_fl_m", "travel_fr_m", "travel_rl_m", "travel_rr_m"),
)

BYTES_A_MOMENT: Final = 800  # of the integrated motion: all columns, and as many while they are made
LOW_PASS_M: Final = (10.0, 50.0)  # of the road's height and slope: a raised cosine leaves half of a wave of that length
LEARNT_M: Final = 10.0  # of way, after which the ground follows the road: a car that stands at its start is on the world's plane z = 0
PROFILE_M: Final = 0.05  # spacing of the road's heights along the way


class CourseParams(Params):
    """Speed and curvature at a time; linear between entries, constant outside."""

    time_s: float = Field(0.0, ge=0, le=1e6, description="time of this entry")
    speed_m_s: float = Field(ge=0, le=100, examples=[20.0], description="speed of the rear axle")
    curvature_1_m: float = Field(
        0.0, ge=-0.2, le=0.2, description="curvature of the rear axle's path, to the left positive: tan(steering angle) / wheelbase"
    )


class SuspensionParams(Params):
    """The sprung mass: heave, pitch and roll are damped oscillators that follow the plane through the four wheels."""

    heave_hz: float = Field(1.2, gt=0, le=10, description="natural frequency of heave")
    pitch_hz: float = Field(1.4, gt=0, le=10, description="natural frequency of pitch")
    roll_hz: float = Field(1.6, gt=0, le=10, description="natural frequency of roll")
    damping: float = Field(0.35, gt=0, le=2, description="damping ratio of all three")
    dive_deg_per_m_s2: float = Field(0.2, ge=0, le=2, description="nose-down pitch per m/s^2 of braking; squat when accelerating")
    lean_deg_per_m_s2: float = Field(0.4, ge=0, le=2, description="outward roll per m/s^2 of lateral acceleration")


class OscillationParams(Params):
    """A sinusoidal pitch in addition to the suspension's."""

    pitch_deg: float = Field(0.0, ge=-5, le=5, description="amplitude, nose down first")
    rate_hz: float = Field(1.2, gt=0, le=20, description="frequency")


class VehicleParams(Params):
    """Course of the vehicle, and dynamics of its body on the suspension."""

    course: tuple[CourseParams, ...] = Field(
        min_length=1, examples=[[{"speed_m_s": 20.0}]], description="speed and curvature over ascending time"
    )
    wheelbase_m: float = Field(2.8, gt=0.5, le=10, description="distance between the axles")
    track_m: float = Field(1.6, gt=0.5, le=3, description="distance between the wheels of an axle")
    overhang_m: float = Field(0.8, ge=0, le=3, description="distance from the lamps back to the front axle")
    suspension: SuspensionParams = Field(SuspensionParams(), description="suspension of the body")
    oscillation: OscillationParams = Field(OscillationParams(), description="additional sinusoidal pitch")
    simulation_hz: float = Field(500.0, ge=50, le=10_000, description="rate of the numerical integration of motion")

    @property
    def pivot_x_m(self) -> float:
        """Where on the ground the body heaves, pitches and rolls: between the wheels."""
        return -(self.overhang_m + self.wheelbase_m / 2)

    @property
    def rear_x_m(self) -> float:
        """The rear axle, which goes where the vehicle heads."""
        return -(self.overhang_m + self.wheelbase_m)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        times = [each.time_s for each in self.course]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError(f"course: time_s must ascend from entry to entry, here {times}")
        return self


@dataclass(frozen=True)
class VehicleState:
    """The vehicle at one time; poses `[4, 4]` float64, pitch and slope nose down and yaw to the left positive (ISO 8855).

    acceleration_m_s2: along, lateral_m_s2: to the left. ground_m: height in the world of the ground frame's origin. slope_rad: of the
    ground, climb_m_s, bend_rad_s: their rates. heave_m: of the body's point between the wheels over the ground, roll_rad and pitch_rad:
    of the body over it. rise_m_s: of that point in the world. roll_rate_rad_s, pitch_rate_rad_s: of the body in the world. travel_fl_m to
    travel_rr_m: how much farther the body is above a wheel than at rest.
    """

    T_world_ground: Tensor
    T_ground_body: Tensor
    speed_m_s: float
    yaw_rate_rad_s: float
    acceleration_m_s2: float
    lateral_m_s2: float
    ground_m: float
    slope_rad: float
    climb_m_s: float
    bend_rad_s: float
    heave_m: float
    roll_rad: float
    pitch_rad: float
    rise_m_s: float
    roll_rate_rad_s: float
    pitch_rate_rad_s: float
    travel_fl_m: float
    travel_fr_m: float
    travel_rl_m: float
    travel_rr_m: float

    @property
    def T_world_body(self) -> Tensor:
        return self.T_world_ground @ self.T_ground_body


@dataclass(frozen=True, eq=False)
class Motion:
    """A drive, integrated.

    times_s: `[N]`, ascending. states: `[N, 21]`, the COLUMNS. pivot_x_m: where on the ground heave, pitch and roll act, between the wheels.
    rear_x_m: the rear axle, which goes where the vehicle heads.
    """

    times_s: Floats
    states: Floats
    pivot_x_m: float = 0.0
    rear_x_m: float = 0.0

    @property
    def range_y_m(self) -> tuple[float, float]:
        """The course's least and greatest y in the world."""
        return float(self.states[:, 1].min()), float(self.states[:, 1].max())

    def at(self, t_s: float) -> VehicleState:
        """The vehicle at a time in s, linear between the integrated times and constant outside."""
        return self._known(min(max(t_s, float(self.times_s[0])), float(self.times_s[-1])))

    @cached_property
    def _known(self) -> Callable[[float], VehicleState]:
        """States by time; a control step asks for the same few again and again."""
        return lru_cache(maxsize=8)(self._interpolated)

    def _interpolated(self, t_s: float) -> VehicleState:
        now = {name: float(np.interp(t_s, self.times_s, column)) for name, column in zip(COLUMNS, self.states.T, strict=True)}
        x, y, yaw = (now.pop(name) for name in ("x_m", "y_m", "yaw_rad"))
        T_world_level = pose(_vector(x, y, 0.0), rotation(*_vector(0.0, 0.0, yaw)))
        T_level_ground = ground_pose(_vector(now["ground_m"], now["slope_rad"]))
        T_ground_body = body_pose(_vector(now["heave_m"], now["roll_rad"], now["pitch_rad"]), self.pivot_x_m)
        return VehicleState(T_world_level @ T_level_ground, T_ground_body, **now)


STANDING: Final = Motion(np.zeros(1), np.zeros((1, len(COLUMNS))))


def body_pose(attitude: Tensor, pivot_x_m: float) -> Tensor:
    """`T_ground_body` `[..., 4, 4]` of an attitude `[..., 3]`: heave in m, roll and pitch (nose down) in rad, about the pivot."""
    heave, roll, pitch = attitude.unbind(-1)
    zero = torch.zeros_like(heave)
    R = rotation(roll, pitch, zero)
    pivot = torch.stack([zero + pivot_x_m, zero, zero], -1)
    return pose(pivot - (R @ pivot[..., None])[..., 0] + torch.stack([zero, zero, heave], -1), R)


def ground_pose(ground: Tensor) -> Tensor:
    """Pose `[4, 4]` of the ground frame in the level one below it, of its height in m and its slope (nose down) in rad `[2]`."""
    height, slope = ground.unbind(-1)
    zero = torch.zeros_like(height)
    return pose(torch.stack([zero, zero, height]), rotation(zero, slope, zero))


def drive(params: VehicleParams, road: Road, duration_s: float) -> Motion:
    """Integrate the vehicle's motion over a road from the world's origin on, for `duration_s`.

    The modes of the body answer to wheels and acceleration as linear systems do whose inputs change linearly in each interval.
    """
    dt = 1 / params.simulation_hz
    afford(f"vehicle: a drive of {duration_s:.3g} s", BYTES_A_MOMENT * duration_s / dt, "take fewer steps, or raise rate_hz")
    t: Floats = np.arange(math.ceil(duration_s / dt) + 2, dtype=np.float64) * dt
    x, y, yaw, speed, yaw_rate = course(params, t)
    acceleration = np.gradient(speed, dt)

    spring = params.suspension
    fl, fr, rl, rr = wheels = _wheel_heights(params, road, x, y, yaw)
    lateral = speed * yaw_rate
    heave = _followed((fl + fr + rl + rr) / 4, spring.heave_hz, spring.damping, dt)
    road_pitch = (rl + rr - fl - fr) / (2 * params.wheelbase_m)
    pitch = _followed(road_pitch, spring.pitch_hz, spring.damping, dt) + _settled(
        -math.radians(spring.dive_deg_per_m_s2) * acceleration, spring.pitch_hz, spring.damping, dt
    )
    road_roll = (fl + rl - fr - rr) / (2 * params.track_m)
    roll = _followed(road_roll, spring.roll_hz, spring.damping, dt) + _settled(
        math.radians(spring.lean_deg_per_m_s2) * lateral, spring.roll_hz, spring.damping, dt
    )
    pitch = pitch + math.radians(params.oscillation.pitch_deg) * np.sin(2 * np.pi * params.oscillation.rate_hz * t)
    level, slope = followed(params, road, _integral(speed, dt), x, y, yaw)
    climb, bend, *rates = (np.gradient(mode, dt) for mode in (level, slope, heave, roll, pitch))
    levers = [(end * params.wheelbase_m / 2, side * params.track_m / 2) for end in (1, -1) for side in (1, -1)]
    travel = (heave + left * roll - front * pitch - wheel for (front, left), wheel in zip(levers, wheels, strict=True))
    over = np.cos(slope) * (heave - level) + np.sin(slope) * params.pivot_x_m
    columns = (x, y, yaw, speed, yaw_rate, acceleration, lateral, level, slope, climb, bend, over, roll, pitch - slope, *rates, *travel)
    return Motion(t, np.stack(columns, axis=1), params.pivot_x_m, params.rear_x_m)


def followed(
    params: VehicleParams,
    road: Road,
    way_m: Floats,
    x: Floats,
    y: Floats,
    yaw: Floats,
    low_pass_m: tuple[float, float] = LOW_PASS_M,
) -> tuple[Floats, Floats]:
    """Height `[N]` in m of the ground frame's origin and slope `[N]` in rad, nose down, of the plane through the low-passed road.

    way_m: `[N]`, that the rear axle has driven, which goes on straight at both ends. x, y, yaw: of the vehicle there, `[N]`, m and rad.
    low_pass_m: lengths over which the road's height and slope are low-passed.
    """
    reach = math.ceil(max(low_pass_m) / 2 / PROFILE_M) + 1
    along = (np.arange(math.ceil(way_m[-1] / PROFILE_M) + 2 * reach + 2) - reach) * PROFILE_M
    at_x, at_y, heading = (np.interp(along, way_m, column) for column in (x, y, yaw))
    beyond = params.rear_x_m + along - np.clip(along, 0, way_m[-1])
    at_x, at_y = at_x + beyond * np.cos(heading), at_y + beyond * np.sin(heading)
    aside = params.track_m / 2 * np.array([[1], [-1]])
    heights = road.z(at_x - aside * np.sin(heading), at_y + aside * np.cos(heading)).mean(0)
    height, level = (np.convolve(heights, _window(each), mode="same") for each in low_pass_m)
    learnt = smoothstep(way_m, 0.0, LEARNT_M)
    slope = -np.arctan(learnt * np.interp(way_m, along, np.gradient(level, PROFILE_M)))
    return learnt * np.interp(way_m, along, height) + params.rear_x_m * np.sin(slope), slope


def _window(length_m: float) -> Floats:
    """A raised cosine of this length, of sum 1, at the profile's spacing."""
    count = round(length_m / 2 / PROFILE_M)
    window = 1 + np.cos(np.pi * np.arange(-count, count + 1) / count)
    return window / window.sum()


def course(params: VehicleParams, t: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Where the vehicle is on the plane at evenly spaced times `[N]` in s from 0 on, whatever the road.

    The rear axle of a kinematic bicycle follows its arc in each interval. Returns x and y in m, yaw in rad, speed in m/s and yaw rate in
    rad/s, each `[N]`.
    """
    knots = np.array([[each.time_s, each.speed_m_s, each.curvature_1_m] for each in params.course])
    speed, curvature = (np.interp(t, knots[:, 0], column) for column in knots.T[1:])
    dt, yaw_rate, rear_m = float(t[1] - t[0]), speed * curvature, -params.rear_x_m
    yaw = _integral(yaw_rate, dt)
    turned = np.diff(yaw)
    way = 0.5 * (speed[1:] + speed[:-1]) * dt * np.sinc(turned / (2 * np.pi))
    middle = yaw[:-1] + turned / 2
    x = np.concatenate([[0.0], np.cumsum(way * np.cos(middle))]) + rear_m * (np.cos(yaw) - 1)
    y = np.concatenate([[0.0], np.cumsum(way * np.sin(middle))]) + rear_m * np.sin(yaw)
    return x, y, yaw, speed, yaw_rate


def _wheel_heights(params: VehicleParams, road: Road, x: Floats, y: Floats, yaw: Floats) -> tuple[Floats, ...]:
    """Heights `[N]` in m of the road under the wheels: front left, front right, rear left, rear right."""
    axles = (-params.overhang_m, params.rear_x_m)
    corners = [(axle, side * params.track_m / 2) for axle in axles for side in (1, -1)]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return tuple(road.z(x + cos * along - sin * across, y + sin * along + cos * across) for along, across in corners)


def _followed(base: Floats, rate_hz: float, damping: float, dt: float) -> Floats:
    """A mass on spring and damper whose other ends move as `base` `[N]`, in equilibrium at first."""
    omega = 2 * math.pi * rate_hz
    return _filtered([2 * damping * omega, omega**2], base, omega, damping, dt)


def _settled(load: Floats, rate_hz: float, damping: float, dt: float) -> Floats:
    """A mass on spring and damper under a load `[N]` that deflects it by its own value in the end, in equilibrium at first."""
    omega = 2 * math.pi * rate_hz
    return _filtered([omega**2], load, omega, damping, dt)


def _filtered(numerator: list[float], values: Floats, omega: float, damping: float, dt: float) -> Floats:
    from scipy.signal import cont2discrete, lfilter, lfilter_zi  # takes a fifth of a command's start, and only vehicles that move need it

    b, a, _ = cont2discrete((numerator, [1.0, 2 * damping * omega, omega**2]), dt, method="foh")
    b = np.ravel(b)
    return np.asarray(lfilter(b, a, values, zi=lfilter_zi(b, a) * values[0])[0], np.float64)


def _integral(values: Floats, dt: float) -> Floats:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt)])


def _vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)
