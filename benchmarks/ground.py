"""How far roads are off the plane of the ground frame ahead of the car: `python benchmarks/ground.py [--json FILE] [--quick]`.

Root mean square of the road's height over that plane 20.6 m ahead of the rear axle, in mm, over a straight way and several seeds: for
rough roads of ISO 8608, and for hills of +-5 % with vertical curves of a radius.
"""

from argparse import Namespace
from itertools import accumulate
from typing import Any

import numpy as np
from bench import run, show

from luxloop.world.roads.base import Road
from luxloop.world.roads.shapes import GradeParams, Iso8608, Profile
from luxloop.world.scene.vehicle import CourseParams, VehicleParams, ground_levels

VEHICLE = VehicleParams(course=(CourseParams(speed_m_s=20.0),))
AHEAD_M = 17.0  # of the lamps
FIRST_M, SPACING_M = 100.0, 0.5  # of the way that counts: behind it the road begins, and the ground goes over to it
PERCENT, STRAIGHT_M = 5.0, 65.0  # of hills, between whose curves grades are straight


def hills(radius_m: float, way_m: float) -> Profile:
    """A road that rises and falls in turn."""
    curve_m = 2 * PERCENT / 100 * radius_m
    count = int(way_m / (curve_m + STRAIGHT_M)) + 2
    places = accumulate([curve_m + STRAIGHT_M] * count, initial=0.0)
    return Profile(grades=tuple(GradeParams(x_m=x, percent=PERCENT * (-1) ** k, curve_m=curve_m) for k, x in enumerate(places)))


def squares_mm2(road: Road, way_m: float) -> np.ndarray:
    """Squares `[N]` in mm^2 of the road's height over the plane, along the way."""
    way = np.arange(0.0, way_m, SPACING_M)
    zero = np.zeros_like(way)
    height, slope = ground_levels(VEHICLE, road, way, way, zero, zero)
    plane = height - VEHICLE.rear_x_m * np.sin(slope) - np.tan(slope) * (AHEAD_M - VEHICLE.rear_x_m)
    return (1e3 * (road.z(way + AHEAD_M, zero) - plane)[way >= FIRST_M]) ** 2


def measure(given: Namespace) -> dict[str, Any]:
    roads = {
        **{f"class {each}": [Iso8608(roughness_class=each, seed=seed) for seed in range(1, given.seeds + 1)] for each in "BCD"},
        **{f"R = {radius_m:.0f} m": [hills(radius_m, given.way_m)] for radius_m in (1000.0, 4000.0)},
    }
    found = {kind: float(np.sqrt(np.mean([squares_mm2(road, given.way_m) for road in each]))) for kind, each in roads.items()}
    show("RMS in mm", {"20.6 m ahead": found})
    return {"rms_mm": found}


if __name__ == "__main__":
    run(measure, __doc__)
