"""Random traffic on and beside the road, and random roads, surfaces and light, all from a seed."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import count, takewhile
from typing import Any

import numpy as np
from pydantic import Field

from luxloop.world.files import afford
from luxloop.world.params import Params, Positive, Seed, in_order
from luxloop.world.scene.vehicle import Course, VehicleParams
from luxloop.world.traffic.animal import AnimalParams
from luxloop.world.traffic.car import CarParams
from luxloop.world.traffic.objects import ClutterParams, ObjectParams, TrafficSignParams
from luxloop.world.traffic.people import CyclistParams, PedestrianParams
from luxloop.world.traffic.route import LANE_M, Met, Route
from luxloop.world.traffic.tracked import WayParams

SIGHT = 0.26  # largest |y| / x of an object: within 15 deg
TRIES = 200
AWAY_S = 30.0  # of motion of objects around a standing vehicle
SHOULDER_M = 1.6  # beside both lanes, for cyclists; other roadside objects stand farther out by as much
BYTES_AN_OBJECT = 1_000_000  # thousands of faces, with normals and planes
Place = tuple[float, float, float]  # x and y in m, yaw in deg


class DriveParams(Params):
    """A drive that meets the traffic."""

    course: Course = Field(min_length=1, examples=[[{"speed_m_s": 20.0}]], description="speed and curvature over ascending time")
    lasts_s: Positive = Field(examples=[60.0], description="how long it lasts")


class TrafficParams(Params):
    """Random road users and roadside objects, in addition to single objects."""

    seed: Seed = Field(0, description="seed of the random scene")
    pedestrians: int = Field(2, ge=0, le=30, description="on pavements, crossing or waiting")
    cyclists: int = Field(1, ge=0, le=20, description="ahead or oncoming")
    cars: int = Field(1, ge=0, le=10, description="ahead or oncoming, with their lamps on")
    parked: int = Field(1, ge=0, le=20, description="cars parked beside the road; they have no category")
    animals: int = Field(0, ge=0, le=10, description="deer")
    signs: int = Field(1, ge=0, le=20, description="traffic signs")
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
        for kind, (counted, _, radius_m, _, make) in ROLES.items():
            for k in range(getattr(self, counted)):
                seed = int(rng.integers(2**31))
                keys, speed, place = next(self._free(rng, taken, radius_m, make), ({}, 0.0, None))
                if place is not None:
                    taken.append((place[0], place[1], radius_m))
                    keys |= {"on_road": self.on_road}
                    found.append(_object(kind, f"{kind}_{k + 1}", seed, place, speed if self.moving else 0.0, keys))
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
        for kind, role in ROLES.items():
            for _ in range(getattr(self, role[0])):
                seed = int(rng.integers(2**31))
                for keys, met in self._tries(rng, k, route, kind, role):
                    if met is not None and not any(met.touches(each) for each in taken):
                        taken.append(met)
                        yield kind, seed, keys, met
                        break

    def _tries(
        self, rng: np.random.Generator, k: int, route: Route, kind: str, role: "Role"
    ) -> Iterator[tuple[dict[str, Any], Met | None]]:
        (*_, half_m, make), moment_s = role, self._moment_s(k, route)
        for _ in range(TRIES):
            x = self._distance(rng) if k == 0 else rng.uniform(k * self.far_m, (k + 1) * self.far_m)
            keys, speed, y, yaw = make(rng)
            ahead = kind == "car" and yaw == 0
            if kind != "car":
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
        self, rng: np.random.Generator, taken: list[tuple[float, float, float]], radius_m: float, make: "Maker"
    ) -> Iterator[tuple[dict[str, Any], float, Place]]:
        """Free places in sight."""
        for _ in range(TRIES):
            x = self._distance(rng)
            keys, speed, y, yaw = make(rng)
            clear = all(np.hypot(x - other_x, y - other_y) > radius_m + other for other_x, other_y, other in taken)
            if clear and abs(y) <= SIGHT * x:
                yield keys, speed, (x, y, yaw)


Made = tuple[dict[str, Any], float, float, float]  # keys, speed in m/s, y in m, yaw in deg
Maker = Callable[[np.random.Generator], Made]
# Key of its count, kind, radius in m of its place, half its length and width in m, function that makes it.
Role = tuple[str, Any, float, tuple[float, float], Maker]


def _object(kind: str, name: str, seed: int, place: Place, speed_m_s: float, keys: dict[str, Any]) -> ObjectParams:
    x, y, yaw = (round(value, 3) for value in place)
    if speed_m_s == 0:
        return ROLES[kind][1](name=name, seed=seed, track=({"position_m": (x, y, 0.0), "yaw_deg": yaw},), **keys)
    way, ahead = AWAY_S * speed_m_s, np.radians(yaw)
    end = (round(x + way * float(np.cos(ahead)), 3), round(y + way * float(np.sin(ahead)), 3), 0.0)
    path = WayParams(points_m=((x, y, 0.0), end), speed_m_s=round(speed_m_s, 3))
    return ROLES[kind][1](name=name, seed=seed, path=path, **keys)


@lru_cache(maxsize=8)  # used repeatedly in a run
def _along(params: TrafficParams, vehicle: VehicleParams, duration_s: float) -> tuple[ObjectParams, ...]:
    route = Route.of(vehicle, duration_s, params.sight_m)
    moments_s = tuple(takewhile(math.isfinite, (params._moment_s(k, route) for k in count())))
    number = len(moments_s) * sum(getattr(params, counted) for counted, *_ in ROLES.values())
    afford(f"traffic: {number:,} objects", BYTES_AN_OBJECT * number, "take fewer steps or objects, or raise far_m")
    found: list[ObjectParams] = []
    taken: list[Met] = []
    names = Counter[str]()
    for k, moment_s in enumerate(moments_s):
        taken = [each for each in taken if each.stop_s > moment_s]
        for kind, seed, keys, met in params._stretch(k, route, taken):
            names[kind] += 1
            if met.start_s <= duration_s:
                found.append(ROLES[kind][1](name=f"{kind}_{names[kind]}", seed=seed, on_road=True, **route.keys(met), **keys))
    return tuple(found)


def _side(rng: np.random.Generator) -> bool:
    return rng.random() < 0.5


def _beside(left: bool, away_m: float) -> float:
    """y of a place at a distance from the road's edge on a side."""
    return LANE_M * 1.5 + away_m if left else -LANE_M / 2 - away_m


def _car(rng: np.random.Generator) -> Made:
    if rng.random() < 0.6:
        return {}, rng.uniform(8, 20), LANE_M + rng.normal(0, 0.2), 180.0
    return {}, rng.uniform(3, 12), rng.normal(0, 0.2), 0.0


def _parking_car(rng: np.random.Generator) -> Made:
    left = _side(rng)
    return {"lit": False, "category": None}, 0.0, _beside(left, 1.1) + rng.normal(0, 0.1), 180.0 if left else 0.0


def _deer(rng: np.random.Generator) -> Made:
    y, walks = rng.uniform(-6, 8), _side(rng)
    return {}, rng.uniform(0.6, 1.5) if walks else 0.0, y, rng.uniform(-180, 180)


def _cyclist(rng: np.random.Generator) -> Made:
    if rng.random() < 0.55:
        return {}, rng.uniform(3, 7), rng.uniform(-1.6, -0.6), 0.0
    return {}, rng.uniform(3, 7), LANE_M * 1.5 - rng.uniform(0.3, 1.2), 180.0


def _pedestrian(rng: np.random.Generator) -> Made:
    walks, crosses = rng.uniform(0.9, 1.8), rng.random() < 0.35
    keys: dict[str, Any] = {"clothing": "vest"} if rng.random() < 0.08 else {}
    if rng.random() < 0.15:
        keys["height_m"] = round(rng.uniform(1.1, 1.5), 2)
    if crosses:
        left = _side(rng)
        return keys, walks, rng.uniform(-4, 5), (-90.0 if left else 90.0) + rng.normal(0, 10)
    left, stands = _side(rng), rng.random() < 0.3
    y = _beside(left, rng.uniform(0.4, 3))
    return keys, 0.0 if stands else walks, y, rng.uniform(-180, 180) if stands else 180.0 * _side(rng)


def _sign(rng: np.random.Generator) -> Made:
    left = rng.random() < 0.3
    y = _beside(left, rng.uniform(0.5, 1.5))
    return {"height_m": round(rng.uniform(1.6, 2.4), 2)}, 0.0, y, (-1 if left else 1) * (180.0 - rng.uniform(0, 12))


def _clutter(rng: np.random.Generator) -> Made:
    shape = ("tree", "bush", "post", "bin", "delineator")[int(rng.choice(5, p=[0.3, 0.25, 0.2, 0.1, 0.15]))]
    away = rng.uniform(1.2, 8)
    return {"shape": shape}, 0.0, _beside(_side(rng), away), rng.uniform(-180, 180)


# in the order of placement: moving ones first
ROLES: dict[str, Role] = {
    "car": ("cars", CarParams, 3.2, (2.6, 1.0), _car),
    "deer": ("animals", AnimalParams, 1.0, (0.9, 0.9), _deer),
    "cyclist": ("cyclists", CyclistParams, 1.1, (1.0, 0.4), _cyclist),
    "pedestrian": ("pedestrians", PedestrianParams, 0.5, (0.4, 0.4), _pedestrian),
    "parked_car": ("parked", CarParams, 2.6, (2.6, 1.0), _parking_car),
    "sign": ("signs", TrafficSignParams, 0.5, (0.4, 0.4), _sign),
    "clutter": ("clutter", ClutterParams, 0.9, (0.9, 0.9), _clutter),
}


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
