"""How far roads are off the plane of the ground frame ahead of the car: `python benchmarks/ground.py [--json FILE] [--quick]`.

Root mean square of the road's height over that plane 12 and 17 m ahead of the lamps, in mm, over a straight way and several seeds, by the
length over which the slope is low-passed: for rough roads of ISO 8608, and for hills of +-5 % with vertical curves of a radius.
"""

from argparse import Namespace
from itertools import accumulate
from typing import Any

import numpy as np
from bench import run, show

from luxloop.world.roads.base import Road
from luxloop.world.roads.shapes import GradeParams, Iso8608, Profile
from luxloop.world.scene.vehicle import LOW_PASS_M, CourseParams, VehicleParams, ground_levels

VEHICLE = VehicleParams(course=(CourseParams(speed_m_s=20.0),))
AHEAD_M = (12.0, 17.0)
SLOPES_M: tuple[float | None, ...] = (10.0, 30.0, 50.0, 100.0, None)  # None: a plane that stays level
FIRST_M, SPACING_M = 100.0, 0.5  # of the way that counts: behind it the road begins, and the ground goes over to it
WAY_M, SEEDS = 4000.0, 5
PERCENT, STRAIGHT_M = 5.0, 65.0  # of hills, between whose curves grades are straight


def hills(radius_m: float, way_m: float) -> Profile:
    """A road that rises and falls in turn."""
    curve_m = 2 * PERCENT / 100 * radius_m
    count = int(way_m / (curve_m + STRAIGHT_M)) + 2
    places = accumulate([curve_m + STRAIGHT_M] * count, initial=0.0)
    return Profile(grades=tuple(GradeParams(x_m=x, percent=PERCENT * (-1) ** k, curve_m=curve_m) for k, x in enumerate(places)))


def roads(way_m: float, seeds: int) -> dict[str, list[Road]]:
    """By name in the table."""
    rough = {f"class {each}": [Iso8608(roughness_class=each, seed=seed) for seed in range(1, seeds + 1)] for each in ("B", "C", "D")}
    return {**rough, **{f"R = {radius_m:.0f} m": [hills(radius_m, way_m)] for radius_m in (1000.0, 4000.0)}}


def squares_mm2(road: Road, slope_m: float | None, way_m: float) -> np.ndarray:
    """Squares `[2, N]` in mm^2 of the road's height over the plane, by AHEAD_M and the way. slope_m: low-pass of the slope."""
    way = np.arange(0.0, way_m, SPACING_M)
    zero = np.zeros_like(way)
    height, slope = ground_levels(VEHICLE, road, way, way, zero, zero, (LOW_PASS_M[0], slope_m or LOW_PASS_M[1]))
    at_axle = height - VEHICLE.rear_x_m * np.sin(slope)
    fall = zero if slope_m is None else np.tan(slope)
    planes = np.stack([at_axle - fall * (x - VEHICLE.rear_x_m) for x in AHEAD_M])
    heights = np.stack([road.z(way + x, zero) for x in AHEAD_M])
    return (1e3 * (heights - planes)[:, way >= FIRST_M]) ** 2


def measure(given: Namespace) -> dict[str, Any]:
    way_m, seeds = (400.0, 1) if given.quick else (WAY_M, SEEDS)
    found: dict[str, dict[str, list[float]]] = {}
    for slope_m in SLOPES_M:
        row = found["a plane that stays level" if slope_m is None else f"{slope_m:g} m"] = {}
        for kind, each in roads(way_m, seeds).items():
            row[kind] = np.sqrt(np.mean([squares_mm2(road, slope_m, way_m).mean(1) for road in each], axis=0)).tolist()
    show(f"RMS in mm at {AHEAD_M} m; the car takes {LOW_PASS_M[1]:g} m", found)
    return {"way_m": way_m, "seeds": seeds, "ahead_m": AHEAD_M, "rms_mm": found}


if __name__ == "__main__":
    run(measure, __doc__, packages=("numpy", "scipy"))
