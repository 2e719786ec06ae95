"""The vehicle's lane as coordinates of objects: way along the lane's centre line, and distance to its left."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np

from luxloop.world.files import afford
from luxloop.world.roads.base import Floats
from luxloop.world.scene.vehicle import VehicleParams, course, integral

LANE_M: Final = 3.5  # width; the own lane's middle is the way, the oncoming lane lies to its left
OWN_M: Final = 5.0  # that the own vehicle reaches behind its lamps
CLEAR_S: Final = 1.0  # of the own way ahead that stays free
PASSED_M: Final = 20.0  # behind the lamps, where objects vanish
LIFE_S: Final = 60.0  # of an object's motion; by then a walker has left the sight even of a waiting car
STEP_S, KEYFRAME_M, POINT_M = 0.05, 2.0, 1.0  # of the drive in time, and of way from keyframe to keyframe and between points of the lane
SLACK_M: Final = 0.05  # by which the lane may come nearer to a place than its own distance; points of the lane lie on chords
BYTES_A_STEP: Final = 150


@dataclass(frozen=True, eq=False)
class Met:
    """An object met on a drive: `places_m` `[2, K]` along the lane and to its left, one for each step from `first` on.

    yaw_deg: its heading against the lane's direction. half_m: `[2, 1]`, half of its size along and across the lane. stride: steps from
    keyframe to keyframe, 0 of what stands.
    """

    first: int
    places_m: Floats
    yaw_deg: float
    half_m: Floats
    stride: int

    @property
    def start_s(self) -> float:
        """Time at which it appears."""
        return self.first * STEP_S

    @property
    def stop_s(self) -> float:
        """Time at which it vanishes."""
        return (self.first + self.places_m.shape[1]) * STEP_S

    def touches(self, other: "Met") -> bool:
        """Whether two objects overlap at any time."""
        since = max(self.first, other.first)
        until = min(each.first + each.places_m.shape[1] for each in (self, other))
        a, b = (each.places_m[:, max(since - each.first, 0) : max(until - each.first, 0)] for each in (self, other))
        return bool((np.abs(a - b) < self.half_m + other.half_m).all(0).any())


@dataclass(frozen=True, eq=False)
class Route:
    """A drive on the plane, and LIFE_S more.

    way_m: `[N]`, where the lamps are along the lane, every STEP_S. rear: `[4, M]`, way in m, x and y in m and yaw in rad of the rear axle,
    extended straight before and after. sight_m: distance ahead at which objects appear.
    """

    way_m: Floats
    rear: Floats
    duration_s: float
    sight_m: float

    @classmethod
    def of(cls, vehicle: VehicleParams, duration_s: float, sight_m: float) -> Self:
        """Raises LuxloopError where memory does not hold it."""
        count = math.ceil((duration_s + LIFE_S) / STEP_S) + 2
        afford(f"traffic: a drive of {duration_s:.3g} s", BYTES_A_STEP * count, "take fewer steps, or raise rate_hz")
        x, y, yaw, speed, _ = course(vehicle, np.arange(count, dtype=np.float64) * STEP_S)
        way = integral(speed, STEP_S)
        back = vehicle.rear_x_m
        rear = np.stack([way + back, x + back * np.cos(yaw), y + back * np.sin(yaw), yaw])
        ends = [rear[:, k] + on * np.array([1, np.cos(yaw[k]), np.sin(yaw[k]), 0]) for k, on in ((0, -3 * sight_m), (-1, 3 * sight_m))]
        return cls(way, np.column_stack([ends[0], rear[:, [True, *(np.diff(way) > 0)]], ends[1]]), duration_s, sight_m)

    def reached_s(self, way_m: float) -> float:
        """Time at which the lamps reach a way, infinite if the drive ends before."""
        time_s = float(np.searchsorted(self.way_m, way_m)) * STEP_S
        return time_s if time_s <= self.duration_s else math.inf

    def world(self, places_m: Floats) -> Floats:
        """x and y in m and the lane's yaw in rad `[3, ...]` of places `[2, ...]`."""
        x, y, yaw = (np.interp(places_m[0], self.rear[0], each) for each in self.rear[1:])
        return np.stack([x - places_m[1] * np.sin(yaw), y + places_m[1] * np.cos(yaw), yaw])

    def met(self, moment_s: float, place_m: Floats, yaw_deg: float, speed_m_s: float, half_m: Floats, led: bool = False) -> Met | None:
        """The motion of an object from a place `[2, 1]` of the lane at a moment, along its heading; None if it would block the vehicle.

        None also where the lane bends so sharply that a place is ambiguous. half_m: `[2, 1]`. led: it leads the vehicle at the vehicle's
        speed.
        """
        after_s, yaw = np.arange(len(self.way_m)) * STEP_S - moment_s, math.radians(yaw_deg)
        along = self.way_m if led else speed_m_s * math.cos(yaw) * after_s
        places = place_m + np.stack([along, np.full_like(along, 0.0) if led else speed_m_s * math.sin(yaw) * after_s])
        ahead = places[0] - self.way_m
        there = (ahead >= -PASSED_M) & (ahead <= self.sight_m) & (after_s >= 0) & ((after_s <= LIFE_S) | led | (speed_m_s == 0))
        steps = np.flatnonzero(there)
        if not len(steps):
            return None
        first, last = int(steps[0]), int(steps[-1])
        places, ahead = places[:, first : last + 1], ahead[first : last + 1]
        soon = np.minimum(np.arange(first, last + 1) + round(CLEAR_S / STEP_S), len(self.way_m) - 1)
        clear_m = self.way_m[soon] - self.way_m[first : last + 1]
        if led:
            in_the_way = ahead[0] < clear_m[0] + half_m[0]
        else:
            in_the_way = (np.abs(places[1]) < LANE_M / 2 + half_m[1]) & (-OWN_M - half_m[0] < ahead) & (ahead < clear_m + half_m[0])
        stride = 2 if led else max(1, round(KEYFRAME_M / speed_m_s / STEP_S)) if speed_m_s else 0
        return None if np.any(in_the_way) or self._folds(places[:, :: round(1 / STEP_S)]) else Met(first, places, yaw_deg, half_m, stride)

    def keys(self, met: Met) -> dict[str, Any]:
        """Track of an object, and the interval in which it exists."""
        last = met.places_m.shape[1] - 1
        steps = np.unique([*range(0, last + 1, met.stride), last]) if met.stride else np.array([0])
        x, y, yaw = self.world(met.places_m[:, steps])
        yaw_deg = (np.degrees(yaw) + met.yaw_deg + 180) % 360 - 180
        rows = np.stack([(met.first + steps) * STEP_S, x, y, yaw_deg], axis=1).round(3).tolist()
        return {
            "track": tuple({"time_s": time_s, "position_m": (x, y, 0.0), "yaw_deg": yaw} for time_s, x, y, yaw in rows),
            "appears_s": round(met.start_s, 3) if met.first else None,
            "vanishes_s": round(met.stop_s, 3) if met.first + last + 1 < len(self.way_m) else None,
        }

    def _folds(self, places_m: Floats) -> bool:
        """Whether the lane comes nearer to one of the places `[2, K]` elsewhere than beside it, as in bends narrower than its distance."""
        low, high = places_m[0].min() - self.sight_m, places_m[0].max() + self.sight_m
        points = self._lane[:, (self._lane[0] >= low) & (self._lane[0] <= high)]
        x, y, _ = self.world(places_m)
        nearest = np.hypot(x[:, None] - points[1], y[:, None] - points[2]).min(1)
        return bool((nearest < np.abs(places_m[1]) - SLACK_M).any())

    @cached_property
    def _lane(self) -> Floats:
        """Points of the lane's middle, `[3, M]`: way, x and y in m."""
        way = np.arange(self.rear[0, 0], self.rear[0, -1], POINT_M)
        return np.stack([way, *self.world(np.stack([way, np.zeros_like(way)]))[:2]])
