"""What each count of random traffic stands for: who they are, where beside or on the road they are, and how they move."""

from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np

from luxloop.world.traffic.animal import AnimalParams
from luxloop.world.traffic.car import CarParams
from luxloop.world.traffic.models import Model, ModelParams
from luxloop.world.traffic.objects import ClutterParams, TrafficSignParams
from luxloop.world.traffic.people import CyclistParams, PedestrianParams
from luxloop.world.traffic.route import LANE_M

Population = Literal["first", "second"]
Made = tuple[dict[str, Any], float, float, float]  # keys, speed in m/s, y in m, yaw in deg
Maker = Callable[[np.random.Generator], Made]
# Key of its count, kind, radius in m of its place, half its length and width in m, function that makes it.
Role = tuple[str, Any, float, tuple[float, float], Maker]


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
FIRST: Final[dict[str, Role]] = {
    "car": ("cars", CarParams, 3.2, (2.6, 1.0), _car),
    "deer": ("animals", AnimalParams, 1.0, (0.9, 0.9), _deer),
    "cyclist": ("cyclists", CyclistParams, 1.1, (1.0, 0.4), _cyclist),
    "pedestrian": ("pedestrians", PedestrianParams, 0.5, (0.4, 0.4), _pedestrian),
    "parked_car": ("parked", CarParams, 2.6, (2.6, 1.0), _parking_car),
    "sign": ("signs", TrafficSignParams, 0.5, (0.4, 0.4), _sign),
    "clutter": ("clutter", ClutterParams, 0.9, (0.9, 0.9), _clutter),
}


def _one_of(rng: np.random.Generator, **weights: float) -> Model:
    """A model, by weight."""
    share = np.array(list(weights.values()))
    return str(rng.choice(list(weights), p=share / share.sum()))  # type: ignore[return-value]


def _vehicle(rng: np.random.Generator) -> Made:
    model = _one_of(rng, microcar=1, estate=2, off_roader=2, pickup=1, lorry=2, bus=1.5, tractor=1, motor_scooter=1.5)
    oncoming = rng.random() < 0.7
    speed = rng.uniform(4, 9) if model == "tractor" else rng.uniform(6, 20)
    return {"model": model}, speed, LANE_M * oncoming + rng.normal(0, 0.25), 180.0 * oncoming


def _parked(rng: np.random.Generator) -> Made:
    """In rows on the right, a few on the left."""
    left, model = rng.random() < 0.25, _one_of(rng, microcar=1, estate=2, off_roader=2, pickup=1)
    return {"model": model, "lit": False, "category": None}, 0.0, _beside(left, 1.15), 180.0 * left


def _rider(rng: np.random.Generator) -> Made:
    """Ahead, oncoming or, two in five, from the side."""
    keys, speed, way = {"model": _one_of(rng, bicycle=3, kick_scooter=1)}, rng.uniform(3, 6.5), rng.random()
    if way < 0.4:
        left = _side(rng)
        return keys, speed, rng.uniform(-5, 7), (-90.0 if left else 90.0) + rng.normal(0, 15)
    if way < 0.7:
        return keys, speed, rng.uniform(-1.7, -0.8), 0.0
    return keys, speed, LANE_M * 1.5 - rng.uniform(0.3, 1.2), 180.0


def _walker(rng: np.random.Generator) -> Made:
    keys: dict[str, Any] = {"model": _one_of(rng, adult=3, coat=2, skirt=1.5, umbrella=1, child=1.5, pram=1, wheelchair=1)}
    if rng.random() < 0.3:
        keys["company"] = _one_of(rng, adult=2, coat=1, skirt=1, child=2)
    way, speed = rng.random(), rng.uniform(0.7, 1.7)
    if way < 0.3:
        return keys, speed, rng.uniform(-5, 7), 90.0 * (-1) ** _side(rng) + rng.normal(0, 20)
    y = _beside(_side(rng), rng.uniform(-0.6, 3.5))
    return (
        (keys, 0.0, y, rng.uniform(-180, 180))
        if way < 0.55
        else (keys, speed, y, (180.0 * _side(rng) + rng.normal(0, 5) + 180) % 360 - 180)
    )


def _beast(rng: np.random.Generator) -> Made:
    walks = rng.uniform(0.6, 1.6) if rng.random() < 0.6 else 0.0
    return {"model": _one_of(rng, boar=3, dog=2)}, walks, rng.uniform(-6, 8), rng.uniform(-180, 180)


def _poster(rng: np.random.Generator) -> Made:
    left = _side(rng)
    return {"model": "poster"}, 0.0, _beside(left, rng.uniform(0.8, 3)), (-1 if left else 1) * (180.0 - rng.uniform(0, 35))


def _thing(rng: np.random.Generator) -> Made:
    model = _one_of(rng, wheelie_bin=2, hydrant=1, statue=1)
    return {"model": model}, 0.0, _beside(_side(rng), rng.uniform(0.3, 5)), rng.uniform(-180, 180)


SECOND: Final[dict[str, Role]] = {
    "vehicle": ("cars", ModelParams.of, 6.5, (6.2, 1.3), _vehicle),
    "beast": ("animals", ModelParams.of, 1.0, (0.9, 0.9), _beast),
    "rider": ("cyclists", ModelParams.of, 1.1, (1.0, 0.4), _rider),
    "walker": ("pedestrians", ModelParams.of, 0.9, (0.9, 0.9), _walker),
    "parked": ("parked", ModelParams.of, 2.8, (2.8, 1.0), _parked),
    "poster": ("signs", ModelParams.of, 0.8, (0.7, 0.7), _poster),
    "thing": ("clutter", ModelParams.of, 0.9, (0.9, 0.9), _thing),
}
POPULATIONS: Final[dict[Population, dict[str, Role]]] = {"first": FIRST, "second": SECOND}
