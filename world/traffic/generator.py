"""Random traffic on and beside the road, and random roads, surfaces and light, all from a seed."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import count, takewhile
from typing import Any

import numpy as np
from pydantic import Field

from luxloop.world.files import afford
from luxloop.world.params import Params, Positive, Seed, in_order
from luxloop.world.scene.vehicle import Course, VehicleParams
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.roles import POPULATIONS, Maker, Population, Role
from luxloop.world.traffic.route import Met, Route
from luxloop.world.traffic.tracked import WayParams

SIGHT = 0.26  # largest |y| / x of an object: within 15 deg
TRIES = 200
ARM_M = 0.65  # between the middles of two people side by side
AWAY_S = 30.0  # of motion of objects around a standing vehicle
SHOULDER_M = 1.6  # beside both lanes, for cyclists; other roadside objects stand farther out by as much
BYTES_AN_OBJECT = 1_000_000  # thousands of faces, with normals and planes
DRIVE_S = 12.0  # of `second_tables`
Place = tuple[float, float, float]  # x and y in m, yaw in deg


class DriveParams(Params):
    """A drive that meets the traffic."""

    course: Course = Field(min_length=1, examples=[[{"speed_m_s": 20.0}]], description="speed and curvature over ascending time")
    lasts_s: Positive = Field(examples=[60.0], description="how long it lasts")


class TrafficParams(Params):
    """Random road users and roadside objects, in addition to single objects."""

    seed: Seed = Field(0, description="seed of the random scene")
    population: Population = Field(
        "first", description="bodies: first, the kinds on which luxloop's network is trained; second, others, of kind model"
    )
    pedestrians: int = Field(2, ge=0, le=30, description="on pavements, crossing or waiting")
    cyclists: int = Field(1, ge=0, le=20, description="ahead or oncoming")
    cars: int = Field(1, ge=0, le=10, description="ahead or oncoming, with their lamps on")
    parked: int = Field(1, ge=0, le=20, description="cars parked beside the road; they have no category")
    animals: int = Field(0, ge=0, le=10, description="deer, or dogs and boars")
    signs: int = Field(1, ge=0, le=20, description="traffic signs, or posters, which have no category")
    clutter: int = Field(4, ge=0, le=50, description="trees, bushes, posts, bins, delineators; they have no category")
    near_m: float = Field(8.0, ge=3, le=100, description="smallest distance ahead at the start")
    far_m: float = Field(
        60.0, ge=10, le=200, description="largest distance ahead at the start; on a drive, length of each section of the route"
    )
    moving: bool = Field(True, description="whether road users move")
    on_road: bool = Field(False, description="whether they stand on the road's surface instead of z = 0; on a drive they always do")
    drive: DriveParams | None = Field(
        None, description="the drive that meets it, where the vehicle takes another one; left out: the vehicle's, over all steps"
    )

    _distances_in_order = in_order("near_m", "far_m")

    @property
    def sight_m(self) -> float:
        """Distance ahead in m at which objects appear on a drive."""
        return 2 * self.far_m

    def objects(self) -> tuple[ObjectParams, ...]:
        """All objects, moving ones first; fewer than requested if the road is full."""
        rng = np.random.default_rng(self.seed)
        taken: list[tuple[float, float, float]] = []
        found: list[ObjectParams] = []
        for kind, (counted, params, radius_m, _, make) in POPULATIONS[self.population].items():
            for k in range(getattr(self, counted)):
                seed = int(rng.integers(2**31))
                keys, speed, place = next(self._free(rng, taken, radius_m, make), ({}, 0.0, None))
                if place is not None:
                    taken.append((place[0], place[1], radius_m))
                    x, y, yaw = place
                    for name, own, (dx, dy) in _group(f"{kind}_{k + 1}", keys, yaw):
                        moves = speed if self.moving else 0.0
                        found.append(_object(params, name, seed, (x + dx, y + dy, yaw), moves, own | {"on_road": self.on_road}))
                        seed += 1
        return tuple(found)

    def along(self, vehicle: VehicleParams, duration_s: float) -> tuple[ObjectParams, ...]:
        """All objects along a drive, on the road's surface; a longer drive begins with the same objects.

        The way is divided into stretches of `far_m`, each with as many objects as `objects` has. They appear when the vehicle is two
        stretches away. No object ever blocks the vehicle or overlaps another. Raises LuxloopError where memory does not hold it.
        """
        if self.drive is not None:
            vehicle, duration_s = vehicle.model_copy(update={"course": self.drive.course}), self.drive.lasts_s
        return self.objects() if not any(each.speed_m_s for each in vehicle.course) else _along(self, vehicle, duration_s)

    def _stretch(self, k: int, route: Route, taken: list[Met]) -> Iterator[tuple[str, int, dict[str, Any], Met]]:
        """Kinds, seeds, keys and motion of the objects in a stretch of a drive; their places are added to `taken`."""
        rng = np.random.default_rng([self.seed, k])
        for kind, role in POPULATIONS[self.population].items():
            for _ in range(getattr(self, role[0])):
                seed = int(rng.integers(2**31))
                for keys, met in self._tries(rng, k, route, role):
                    if met is not None and not any(met.touches(each) for each in taken):
                        taken.append(met)
                        yield kind, seed, keys, met
                        break

    def _tries(self, rng: np.random.Generator, k: int, route: Route, role: Role) -> Iterator[tuple[dict[str, Any], Met | None]]:
        (counted, *_, half_m, make), moment_s = role, self._moment_s(k, route)
        for _ in range(TRIES):
            x = self._distance(rng) if k == 0 else rng.uniform(k * self.far_m, (k + 1) * self.far_m)
            keys, speed, y, yaw = make(rng)
            ahead = counted == "cars" and yaw == 0
            if counted != "cars":
                y += float(np.copysign(SHOULDER_M, y))
            if abs(y) <= SIGHT * x and not (ahead and k):  # cars ahead keep the vehicle's speed, so none is met later
                place_m, half = np.array([[x], [y]]), np.array(half_m)[:, None]
                yield keys, route.met(moment_s, place_m, yaw, speed if self.moving else 0.0, half, led=ahead and self.moving)

    def _moment_s(self, k: int, route: Route) -> float:
        """Time at which a stretch's traffic appears, with the vehicle two stretches away; infinite if the drive ends before."""
        return route.reached_s(max(k - 2, 0) * self.far_m)

    def _distance(self, rng: np.random.Generator) -> float:
        """A distance, uniform in its logarithm."""
        return float(np.exp(rng.uniform(np.log(self.near_m), np.log(self.far_m))))

    def _free(
        self, rng: np.random.Generator, taken: list[tuple[float, float, float]], radius_m: float, make: Maker
    ) -> Iterator[tuple[dict[str, Any], float, Place]]:
        """Free places in sight."""
        for _ in range(TRIES):
            x = self._distance(rng)
            keys, speed, y, yaw = make(rng)
            clear = all(np.hypot(x - other_x, y - other_y) > radius_m + other for other_x, other_y, other in taken)
            if clear and abs(y) <= SIGHT * x:
                yield keys, speed, (x, y, yaw)


def _group(name: str, keys: dict[str, Any], yaw_deg: float) -> Iterator[tuple[str, dict[str, Any], tuple[float, float]]]:
    """Names, keys, and places in m beside the first, of somebody and of company at the left hand."""
    company = keys.get("company")
    alone = {key: value for key, value in keys.items() if key != "company"}
    yield name, alone, (0.0, 0.0)
    if company is not None:
        yaw = np.radians(yaw_deg)
        yield f"{name}_company", alone | {"model": company}, (-ARM_M * float(np.sin(yaw)), ARM_M * float(np.cos(yaw)))


def _object(kind: Any, name: str, seed: int, place: Place, speed_m_s: float, keys: dict[str, Any]) -> ObjectParams:
    x, y, yaw = (round(value, 3) for value in place)
    if speed_m_s == 0:
        return kind(name=name, seed=seed, track=({"position_m": (x, y, 0.0), "yaw_deg": yaw},), **keys)
    way, ahead = AWAY_S * speed_m_s, np.radians(yaw)
    end = (round(x + way * float(np.cos(ahead)), 3), round(y + way * float(np.sin(ahead)), 3), 0.0)
    path = WayParams(points_m=((x, y, 0.0), end), speed_m_s=round(speed_m_s, 3))
    return kind(name=name, seed=seed, path=path, **keys)


@lru_cache(maxsize=8)  # used repeatedly in a run
def _along(params: TrafficParams, vehicle: VehicleParams, duration_s: float) -> tuple[ObjectParams, ...]:
    route, roles = Route.of(vehicle, duration_s, params.sight_m), POPULATIONS[params.population]
    moments_s = tuple(takewhile(math.isfinite, (params._moment_s(k, route) for k in count())))
    number = len(moments_s) * sum(getattr(params, counted) for counted, *_ in roles.values())
    afford(f"traffic: {number:,} objects", BYTES_AN_OBJECT * number, "take fewer steps or objects, or raise far_m")
    found: list[ObjectParams] = []
    taken: list[Met] = []
    names = Counter[str]()
    for k, moment_s in enumerate(moments_s):
        taken = [each for each in taken if each.stop_s > moment_s]
        for kind, seed, keys, met in params._stretch(k, route, taken):
            names[kind] += 1
            if met.start_s <= duration_s:
                for name, own, beside_m in _group(f"{kind}_{names[kind]}", keys, met.yaw_deg):
                    where = route.keys(replace(met, places_m=met.places_m + np.array(beside_m)[:, None]))
                    found.append(roles[kind][1](name=name, seed=seed, on_road=True, **where, **own))
                    seed += 1
    return tuple(found)


def random_tables(seed: int) -> dict[str, Any]:
    """Random tables `road`, `surface`, `light` and `traffic` of a scenario from a seed: nearly level roads at night."""
    rng = np.random.default_rng([seed, 1])
    roads: list[dict[str, Any]] = [
        {"kind": "flat"},
        {"kind": "bumps", "seed": int(rng.integers(1000)), "highest_m": 0.03, "lowest_m": -0.02},
        {"kind": "iso8608", "seed": int(rng.integers(1000)), "roughness_class": "AB"[int(rng.integers(2))]},
    ]
    surface = {
        "albedo": round(rng.uniform(0.07, 0.3), 3),
        "grain": round(rng.uniform(0.05, 0.2), 3),
        "patches": int(rng.integers(6)),
        "markings": rng.random() < 0.6,
        "seed": int(rng.integers(1000)),
    }
    light: dict[str, Any] = {"ambient_lx": round(float(10 ** rng.uniform(-2.5, -0.5)), 4)}
    if rng.random() < 0.3:
        light["street_lamps"] = [
            {"position_m": [x + rng.uniform(0, 10), 7.5, 7.0], "intensity_cd": round(rng.uniform(50, 800), 1)} for x in (15.0, 45.0)
        ]
    counts = {"pedestrians": (0, 5), "cyclists": (0, 3), "cars": (0, 3), "parked": (0, 3), "animals": (0, 2), "signs": (0, 3)}
    traffic = {"seed": seed, **{key: int(rng.integers(*of)) for key, of in counts.items()}, "clutter": int(rng.integers(2, 9))}
    return {"road": roads[int(rng.integers(3))], "surface": surface, "light": light, "traffic": traffic}


def second_tables(seed: int) -> dict[str, Any]:
    """`random_tables` of the second population, with a drive of DRIVE_S at 5 to 20 m/s round bends and over crests, and rain."""
    rng = np.random.default_rng([seed, 4])
    speed = rng.uniform(5, 20)
    moments = np.arange(0.0, DRIVE_S, 3.0)
    bends = rng.uniform(-1, 1, len(moments)) * min(2.0 / speed**2, 0.02) * (rng.random() < 0.7)  # 2 m/s^2 at the mean speed
    course = [
        {"time_s": float(t), "speed_m_s": round(float(np.clip(speed + rng.normal(0, 1), 5, 20)), 2), "curvature_1_m": round(float(c), 5)}
        for t, c in zip(moments, bends, strict=True)
    ]
    grades, x, percent = [], rng.uniform(5, 30), 0.0
    while x < 25 * DRIVE_S:
        new = rng.uniform(-6, 6)
        curve_m = abs(new - percent) / 100 * rng.uniform(600, 2000) + 5  # radii of crests and sags
        grades.append({"x_m": round(x, 1), "percent": round(new, 2), "curve_m": round(curve_m, 1)})
        x, percent = x + curve_m + rng.uniform(10, 80), new
    road = {"kind": "profile", "grades": grades, "roughness_class": "AB"[int(rng.integers(2))], "seed": int(rng.integers(1000))}
    wet = round(rng.uniform(0.3, 1), 2) if rng.random() < 0.4 else 0.0
    surface = {"albedo": round(rng.uniform(0.06, 0.25), 3), "wet": wet, "markings": not bends.any(), "seed": int(rng.integers(1000))}
    counts = {
        "pedestrians": (1, 6),
        "cyclists": (1, 4),
        "cars": (0, 3),
        "parked": (0, 7),
        "animals": (0, 2),
        "signs": (0, 3),
        "clutter": (2, 9),
    }
    traffic = {"seed": seed, "population": "second", **{key: int(rng.integers(*of)) for key, of in counts.items()}}
    return {
        "conditions": [{"wet": wet > 0}],
        "road": road,
        "surface": surface,
        "light": {"ambient_lx": round(float(10 ** rng.uniform(-2.5, -0.3)), 4)},
        "vehicle": {"course": course},
        "traffic": traffic,
    }
