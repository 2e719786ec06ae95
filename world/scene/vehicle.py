"""The vehicle in motion: its course, the ground frame that follows the road, and the sprung body, excited by road and acceleration.

Three frames, all x forward, y left, z up, which coincide while the vehicle stands, the origin below the middle of its lamps: the *world*;
the *ground*, which drives along the course on the plane through the low-passed road under the rear axle, x along its slope; and the *body*
on its springs, which lamps and camera are fixed to.
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from itertools import takewhile
from typing import Annotated, Final, NamedTuple, Self

import numpy as np
import scipy  # loads its parts on first use
import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.caches import keeping
from luxloop.world.files import afford
from luxloop.world.frames import pose, rotation, transform
from luxloop.world.params import NotNegative, Params, ascending
from luxloop.world.roads.base import Floats, Road, smoothstep

BYTES_A_MOMENT: Final = 900  # of the integrated motion, with temporaries
LOW_PASS_M: Final = (10.0, 50.0)  # wavelengths of height and slope at which the low-pass, a raised cosine, halves the amplitude
LEARNT_M: Final = 10.0  # of way, over which the ground frame leaves the world's plane z = 0 of the start for the road
PROFILE_M: Final = 0.05  # spacing of the road's heights along the way
AHEAD_M: Final = 200.0  # of the drive's end, up to which its course goes straight on
COURSE_S: Final = 0.1  # between the places that give the course


class CourseParams(Params):
    """Speed and curvature at a time; linear between entries, constant outside."""

    time_s: NotNegative = Field(0.0, description="time of this entry")
    speed_m_s: float = Field(ge=0, le=100, examples=[20.0], description="speed of the rear axle")
    curvature_1_m: float = Field(
        0.0, ge=-0.2, le=0.2, description="curvature of the rear axle's path, to the left positive: tan(steering angle) / wheelbase"
    )


Course = Annotated[tuple[CourseParams, ...], ascending("time_s")]


class SpringParams(Params):
    """The sprung mass: heave, pitch and roll are damped oscillators that follow the plane through the four wheels."""

    heave_hz: float = Field(1.2, gt=0, le=10, description="natural frequency of heave")
    pitch_hz: float = Field(1.4, gt=0, le=10, description="natural frequency of pitch")
    roll_hz: float = Field(1.6, gt=0, le=10, description="natural frequency of roll")
    damping: float = Field(0.35, gt=0, le=2, description="damping ratio of all three")


class SuspensionParams(SpringParams):
    """The sprung mass, and how it leans to accelerations."""

    dive_deg_per_m_s2: float = Field(0.2, ge=0, le=2, description="nose-down pitch per m/s^2 of braking; squat when accelerating")
    lean_deg_per_m_s2: float = Field(0.4, ge=0, le=2, description="outward roll per m/s^2 of lateral acceleration")


class OscillationParams(Params):
    """A sinusoidal pitch in addition to the suspension's."""

    pitch_deg: float = Field(0.0, ge=-5, le=5, description="amplitude, nose down first")
    rate_hz: float = Field(1.2, gt=0, le=20, description="frequency")


class VehicleParams(Params):
    """Course of the vehicle, and dynamics of its body on the suspension."""

    course: Course = Field(min_length=1, examples=[[{"speed_m_s": 20.0}]], description="speed and curvature over ascending time")
    wheelbase_m: float = Field(2.8, gt=0.5, le=10, description="distance between the axles")
    track_m: float = Field(1.6, gt=0.5, le=3, description="distance between the wheels of an axle")
    overhang_m: float = Field(0.8, ge=0, le=3, description="distance from the lamps back to the front axle")
    suspension: SuspensionParams = Field(SuspensionParams(), description="suspension of the body")
    oscillation: OscillationParams = Field(OscillationParams(), description="additional sinusoidal pitch")
    roams: bool = Field(
        False, description="whether the road is there all around, for somebody who drives the vehicle, in place of along its course"
    )
    simulation_hz: float = Field(500.0, ge=50, le=10_000, description="rate of the numerical integration of motion")

    @property
    def pivot_x_m(self) -> float:
        """Pivot of heave, pitch and roll on the ground: midway between the axles."""
        return -(self.overhang_m + self.wheelbase_m / 2)

    @property
    def rear_x_m(self) -> float:
        """The rear axle, which moves along the vehicle's heading."""
        return -(self.overhang_m + self.wheelbase_m)


@dataclass(frozen=True)
class VehicleState:
    """The vehicle at one time; poses `[4, 4]` float64, pitch and slope nose down and yaw to the left positive (ISO 8855).

    acceleration_m_s2: along, lateral_m_s2: to the left. ground_m: height in the world of the ground frame's origin. slope_rad: of the
    ground, climb_m_s, bend_rad_s: their rates. heave_m: of the body's point between the wheels over the ground, roll_rad and pitch_rad: of
    the body over it. rise_m_s: of that point in the world. roll_rate_rad_s, pitch_rate_rad_s: of the body in the world. travel_fl_m to
    travel_rr_m: rise of the body above a wheel, against rest.
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


# Columns of the integrated states: position of the vehicle, then the fields of VehicleState.
COLUMNS: Final = ("x_m", "y_m", "yaw_rad", *(each.name for each in fields(VehicleState) if not each.name.startswith("T_")))


@dataclass(frozen=True, eq=False)
class Motion:
    """The integrated motion of a drive.

    times_s: `[N]`, ascending. states: `[N, 21]`, the COLUMNS. pivot_x_m: of heave, pitch and roll. rear_x_m: of the rear axle. modes: `[N,
    4]`, way in m, and the body's heave in m, pitch and roll in rad over a level plane. of: vehicle and road.
    """

    times_s: Floats
    states: Floats
    pivot_x_m: float = 0.0
    rear_x_m: float = 0.0
    modes: Floats = field(default_factory=lambda: np.zeros((1, 4)))
    of: tuple[VehicleParams, Road] | None = None

    @classmethod
    def standing(cls, x_m: float = 0.0, y_m: float = 0.0, yaw_deg: float = 0.0) -> Self:
        """A vehicle that stands at a place on the world's plane z = 0."""
        return cls(np.zeros(1), np.array([[x_m, y_m, math.radians(yaw_deg), *(0.0 for _ in COLUMNS[3:])]]))

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands throughout."""
        return len(self.times_s) == 1

    @property
    def range_y_m(self) -> tuple[float, float]:
        """The course's least and greatest y in the world."""
        return float(self.states[:, 1].min()), float(self.states[:, 1].max())

    def at(self, t_s: float) -> VehicleState:
        """The vehicle at a time in s, linear between the integrated times and constant outside."""
        return self._state_cache(min(max(t_s, float(self.times_s[0])), float(self.times_s[-1])))

    @cached_property
    def _state_cache(self) -> Callable[[float], VehicleState]:
        """Cache of states by time, as a control step asks for the same few repeatedly."""
        return keeping(8, self._interpolate)

    def _interpolate(self, t_s: float) -> VehicleState:
        k = max(int(np.searchsorted(self.times_s, t_s)) - 1, 0)
        times_s, states = self.times_s[k : k + 2], self.states[k : k + 2]
        now = {name: float(np.interp(t_s, times_s, column)) for name, column in zip(COLUMNS, states.T, strict=True)}
        x, y, yaw = (now.pop(name) for name in ("x_m", "y_m", "yaw_rad"))
        T_world_level = pose(_vector(x, y, 0.0), rotation(*_vector(0.0, 0.0, yaw)))
        T_level_ground = ground_pose(_vector(now["ground_m"], now["slope_rad"]))
        T_ground_body = body_pose(_vector(now["heave_m"], now["roll_rad"], now["pitch_rad"]), self.pivot_x_m)
        return VehicleState(T_world_level @ T_level_ground, T_ground_body, **now)


STANDING: Final = Motion.standing()


class VehiclePath(NamedTuple):
    """The vehicle's path in the world by ascending x: x and y in m, heading in rad, all `[n]`."""

    x_m: np.ndarray
    y_m: np.ndarray
    heading: np.ndarray

    @classmethod
    def of(cls, motion: Motion, duration_s: float) -> "VehiclePath":
        """The course of a drive, straight on after its end."""
        poses = [motion.at(t).T_world_ground for t in np.arange(0, duration_s + COURSE_S, COURSE_S)]
        ahead = torch.tensor([[AHEAD_M, 0.0, 0.0]], dtype=torch.float64).T
        way, last = torch.stack([*(each[:2, 3] for each in poses), transform(poses[-1], ahead)[:2, 0]]), [poses[-1]]
        heading = np.array([torch.atan2(each[1, 0], each[0, 0]) for each in poses + last])
        x, y = way.T.numpy()
        order = np.argsort(x, kind="stable")
        return cls(x[order], y[order], heading[order])

    def aside_m(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Distances in m of places of the world to the left of the course."""
        return (y_m - np.interp(x_m, self.x_m, self.y_m)) * np.cos(np.interp(x_m, self.x_m, self.heading))


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


def drive(params: VehicleParams, road: Road, duration_s: float, before: Motion = STANDING) -> Motion:
    """Integrate the vehicle's motion over a road from the world's origin on, for `duration_s`.

    The body's modes respond to wheels and acceleration as linear systems whose inputs change linearly in each interval. before: another
    drive; its states are reused to the bit as long as both courses are equal, and the integration continues from there.
    """
    dt = 1 / params.simulation_hz
    afford(f"vehicle: a drive of {duration_s:.3g} s", BYTES_A_MOMENT * duration_s / dt, "take fewer steps, or raise rate_hz")
    times: Floats = np.arange(math.ceil(duration_s / dt) + 2, dtype=np.float64) * dt
    kept = _moments_alike(before, params, road, times)
    first = max(kept - 2, 0)  # filters and slopes continue from two known moments
    t, start, past = times[first:], before.states[first], before.modes[first:kept].T if kept else None
    x, y, yaw, speed, yaw_rate = course(params, t, start[:3])
    acceleration, lateral = np.gradient(speed, dt), speed * yaw_rate

    spring = params.suspension
    fl, fr, rl, rr = wheels = _wheel_heights(params, road, x, y, yaw)
    heaves, pitches, rolls = (_Mode(hz, spring.damping, dt) for hz in (spring.heave_hz, spring.pitch_hz, spring.roll_hz))
    heave = heaves.follows((fl + fr + rl + rr) / 4, None if past is None else past[1])
    road_pitch, dive = (rl + rr - fl - fr) / (2 * params.wheelbase_m), -math.radians(spring.dive_deg_per_m_s2) * acceleration
    pitch = pitches.answers(road_pitch, dive, None if past is None else past[2])
    road_roll, lean = (fl + rl - fr - rr) / (2 * params.track_m), math.radians(spring.lean_deg_per_m_s2) * lateral
    roll = rolls.answers(road_roll, lean, None if past is None else past[3])
    modes = (before.modes[first, 0] + integral(speed, dt), heave, pitch, roll)
    pitch = pitch + math.radians(params.oscillation.pitch_deg) * np.sin(2 * np.pi * params.oscillation.rate_hz * t)
    level, slope, climb, bend = (each[len(each) - len(t) :] for each in _ground(params, road, dt, modes[0], (x, y, yaw), before, first))
    rates = (np.gradient(mode, dt) for mode in (heave, roll, pitch))
    levers = [(end * params.wheelbase_m / 2, side * params.track_m / 2) for end in (1, -1) for side in (1, -1)]
    travel = (heave + left * roll - front * pitch - wheel for (front, left), wheel in zip(levers, wheels, strict=True))
    over = np.cos(slope) * (heave - level) + np.sin(slope) * params.pivot_x_m
    columns = (x, y, yaw, speed, yaw_rate, acceleration, lateral, level, slope, climb, bend, over, roll, pitch - slope, *rates, *travel)
    states, inner = (
        np.concatenate([old[:kept], np.stack(new, axis=1)[kept - first :]])
        for old, new in ((before.states, columns), (before.modes, modes))
    )
    return Motion(times, states, params.pivot_x_m, params.rear_x_m, inner, (params, road))


def _moments_alike(before: Motion, params: VehicleParams, road: Road, times: Floats) -> int:
    """Number of leading moments that two drives share: none, or at least two."""
    if before.of is None or before.of != (params.model_copy(update={"course": before.of[0].course}), road):
        return 0
    until_s = _same_until(before.of[0].course, params.course)
    kept = int(np.searchsorted(times[: len(before.times_s)], until_s, side="right"))
    return kept if kept > 1 else 0


def _same_until(a: tuple[CourseParams, ...], b: tuple[CourseParams, ...]) -> float:
    """Time in s until which two courses are equal, infinite if they always are."""
    alike = sum(1 for _ in takewhile(lambda pair: pair[0] is pair[1], zip(a, b, strict=False)))
    first, second = (_knots(each[max(alike - 1, 0) :]) for each in (a, b))
    times = np.union1d(first[0], second[0])
    differ = [
        np.interp(times, first[0], mine) != np.interp(times, second[0], other) for mine, other in zip(first[1:], second[1:], strict=True)
    ]
    there = np.flatnonzero(differ[0] | differ[1])
    return math.inf if not len(there) else float(times[there[0] - 1]) if there[0] else -math.inf


def _ground(
    params: VehicleParams, road: Road, dt: float, way_m: Floats, pose: tuple[Floats, Floats, Floats], before: Motion, first: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Level, slope and their rates at the last moments of a way and poses. before, first: an earlier drive, and the number of its moments
    before these, as many as the low-passes reach back.
    """
    back = int(np.searchsorted(before.modes[:first, 0], way_m[0] - max(LOW_PASS_M) / 2 - 1))
    along = np.concatenate([before.modes[back:first, 0], way_m])
    x, y, yaw = (np.concatenate([before.states[back:first, k], each]) for k, each in enumerate(pose))
    level, slope = ground_levels(params, road, along, x, y, yaw)
    return level, slope, np.gradient(level, dt), np.gradient(slope, dt)


def ground_levels(params: VehicleParams, road: Road, way_m: Floats, x: Floats, y: Floats, yaw: Floats) -> tuple[Floats, Floats]:
    """Height `[N]` in m of the ground frame's origin and slope `[N]` in rad, nose down, of the plane through the low-passed road.

    way_m: `[N]`, way of the rear axle from the world's origin, extended straight at both ends. x, y, yaw: of the vehicle there, `[N]`, m
    and rad.
    """
    reach = math.ceil(max(LOW_PASS_M) / 2 / PROFILE_M) + 1
    along = np.arange(math.floor(way_m[0] / PROFILE_M) - reach, math.ceil(way_m[-1] / PROFILE_M) + reach + 2) * PROFILE_M
    at_x, at_y, heading = (np.interp(along, way_m, column) for column in (x, y, yaw))
    beyond = params.rear_x_m + along - np.clip(along, way_m[0], way_m[-1])
    at_x, at_y = at_x + beyond * np.cos(heading), at_y + beyond * np.sin(heading)
    aside = params.track_m / 2 * np.array([[1], [-1]])
    heights = road.z(at_x - aside * np.sin(heading), at_y + aside * np.cos(heading)).mean(0)
    height, level = (np.convolve(heights, _window(each), mode="same") for each in LOW_PASS_M)
    learnt = smoothstep(way_m, 0.0, LEARNT_M)
    slope = -np.arctan(learnt * np.interp(way_m, along, np.gradient(level, PROFILE_M)))
    return learnt * np.interp(way_m, along, height) + params.rear_x_m * np.sin(slope), slope


def _window(length_m: float) -> Floats:
    """A raised cosine of this length, of sum 1, at the profile's spacing."""
    count = round(length_m / 2 / PROFILE_M)
    window = 1 + np.cos(np.pi * np.arange(-count, count + 1) / count)
    return window / window.sum()


def course(params: VehicleParams, t: Floats, start: Floats | None = None) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Planar motion at evenly spaced times `[N]` in s, independent of the road.

    The rear axle of a kinematic bicycle follows its arc in each interval. start: x, y and yaw at the first time, else 0. Returns x and y in
    m, yaw in rad, speed in m/s and yaw rate in rad/s, each `[N]`.
    """
    begun = bisect_right(params.course, t[0], key=lambda each: each.time_s)
    knots = _knots(params.course[max(begun - 1, 0) :])
    speed, curvature = (np.interp(t, knots[0], column) for column in knots[1:])
    dt, yaw_rate, rear_m = float(t[1] - t[0]), speed * curvature, -params.rear_x_m
    x_0, y_0, yaw_0 = (0.0, 0.0, 0.0) if start is None else start.tolist()
    yaw = yaw_0 + integral(yaw_rate, dt)
    turned = np.diff(yaw)
    way = 0.5 * (speed[1:] + speed[:-1]) * dt * np.sinc(turned / (2 * np.pi))
    middle = yaw[:-1] + turned / 2
    x = x_0 + np.concatenate([[0.0], np.cumsum(way * np.cos(middle))]) + rear_m * (np.cos(yaw) - math.cos(yaw_0))
    y = y_0 + np.concatenate([[0.0], np.cumsum(way * np.sin(middle))]) + rear_m * (np.sin(yaw) - math.sin(yaw_0))
    return x, y, yaw, speed, yaw_rate


def _knots(entries: tuple[CourseParams, ...]) -> Floats:
    """Times, speeds and curvatures `[3, K]`."""
    return np.array([[each.time_s, each.speed_m_s, each.curvature_1_m] for each in entries]).T


def _wheel_heights(params: VehicleParams, road: Road, x: Floats, y: Floats, yaw: Floats) -> tuple[Floats, ...]:
    """Heights `[N]` in m of the road under the wheels: front left, front right, rear left, rear right."""
    axles = (-params.overhang_m, params.rear_x_m)
    corners = [(axle, side * params.track_m / 2) for axle in axles for side in (1, -1)]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return tuple(road.z(x + cos * along - sin * across, y + sin * along + cos * across) for along, across in corners)


@dataclass(frozen=True)
class _Mode:
    """A mass on spring and damper, initially in equilibrium unless its first two values are known."""

    rate_hz: float
    damping: float
    dt: float

    def follows(self, base: Floats, known: Floats | None) -> Floats:
        """Position of the mass for a base motion `[N]`."""
        omega = 2 * math.pi * self.rate_hz
        return self._response((2 * self.damping * omega, omega**2), base, known)

    def answers(self, base: Floats, load: Floats, known: Floats | None) -> Floats:
        """Position for a base motion and a load, both `[N]`; a constant load deflects the mass by the load's value."""
        omega = 2 * math.pi * self.rate_hz
        return self.follows(base, known) + self._response((0.0, omega**2), load, None if known is None else 0 * known)

    def _response(self, numerator: tuple[float, float], values: Floats, known: Floats | None) -> Floats:
        """Solves `y_k + a_1 y_(k-1) + a_2 y_(k-2) = b_0 u_k + b_1 u_(k-1) + b_2 u_(k-2)` of inputs u `[N]` for y `[N]`."""
        if known is None:  # in equilibrium before
            return self._response(numerator, np.concatenate([values[[0, 0]], values]), values[[0, 0]])[2:]
        b, a = _recursion(numerator, 2 * math.pi * self.rate_hz, self.damping, self.dt)
        right = np.convolve(values, b)[: len(values)]
        right[:2] = known[0], known[1] + a[1] * known[0]
        bands = np.asfortranarray(np.broadcast_to(a[:, None], (3, len(values))))
        return np.asarray(scipy.linalg.blas.dtbsv(2, bands, right, lower=1, diag=1), np.float64)


@lru_cache(maxsize=16)
def _recursion(numerator: tuple[float, float], omega: float, damping: float, dt: float) -> tuple[Floats, Floats]:
    """b and a, `[3]` each, of `(n_1 s + n_0) / (s^2 + 2 damping omega s + omega^2)` for inputs that change linearly in each interval."""
    system = np.zeros((4, 4))  # of the state [2], the input and its change in an interval
    system[:2] = [[-2 * damping * omega * dt, -(omega**2) * dt, dt, 0], [dt, 0, 0, 0]]
    system[2, 3] = 1
    step = torch.linalg.matrix_exp(torch.from_numpy(system)).numpy()
    A, held, rising = step[:2, :2], step[:2, 2], step[:2, 3]
    a = np.array([1, -np.trace(A), np.linalg.det(A)])
    states = np.stack([rising, A @ rising + held - rising, A @ (A @ rising + held - rising)])  # after an input of 1, 0, 0
    return np.convolve(states @ numerator, a)[:3], a


def integral(values: Floats, dt: float) -> Floats:
    """Integral `[N]` of values `[N]` at evenly spaced times, 0 at the first, linear in between."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt)])


def _vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


@dataclass(frozen=True, eq=False)
class LateBody(Motion):
    """A drive with heave, roll and pitch delayed by `late_s`; way, ground and speed are undelayed.

    dynamics: the undelayed drive, which the sensors measure.
    """

    dynamics: Motion = STANDING
    late_s: float = 0.0

    @classmethod
    def behind(cls, motion: Motion, late_s: float) -> Self:
        """late_s: in s."""
        own = motion.times_s, motion.states, motion.pivot_x_m, motion.rear_x_m, motion.modes, motion.of
        return cls(*own, motion, late_s)

    def at(self, t_s: float) -> VehicleState:
        """The vehicle at a time in s."""
        then = self.dynamics.at(t_s - self.late_s)
        moved = {name: getattr(then, name) for name in ("T_ground_body", "heave_m", "roll_rad", "pitch_rad")}
        return replace(self.dynamics.at(t_s), **moved)
