"""Lighting functions on a car that drives: they live in the ground frame, and aim by what its sensors say of the body."""

from typing import Any

import pytest
import torch

from luxloop import Simulation
from luxloop.loop.simulation.result import StepResult
from luxloop.world.frames import inverse, transform
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulated, toml, van

NODS = toml("{ course = [{ speed_m_s = 20.0 }], oscillation = { pitch_deg = 1.0, rate_hz = 1.25 } }")
ONCOMING = van((70.0, 3.0, 180.0), (60.0, 3.0, 180.0))
WAY = toml("{ kind = 'symbol', image = 'chevrons', x_m = 20.0, width_m = 3.0, length_m = 6.0 }")


MOVES = """
name = "moves"
steps = 4
rate_hz = 5
renderer = "raycast"
headlight.model = "ssl-hd-lores"
camera = { width_px = 320, height_px = 120, oversampling = 1, saturation_e = 4000 }
surface.grain = 0.0
"""
HIRES = "headlight={ model='ssl-hd', modules=['hires'] }"


def simulation(*overrides: str, **changes: Any) -> Simulation:
    return simulated(MOVES, *overrides, **{"vehicle": NODS, **changes})


def lit_middle(moving: Simulation, each: StepResult) -> torch.Tensor:
    """Mean place `[3]` of what is brightly lit, in the ground frame."""
    vehicle, surfaces = moving.world.motion.at(each.time_s), moving.world.lit(each.time_s).surfaces
    lit = each.illuminance > 0.5 * each.illuminance.max()
    return transform(inverse(vehicle.T_world_ground).float(), surfaces.position[:, lit]).mean(1)


def test_masks_stay_on_an_oncoming_car_while_the_own_one_nods():
    guarded = simulation("lighting.base.beam=high", "functions.guard.kind=glare_free", objects=[ONCOMING])
    results = list(guarded.evaluations())
    assert len({float(each.sense.view.T_world_view[2, 2]) for each in results}) == 3  # it does nod
    assert all(each.objects["van"].pixels and each.objects["van"].lx_max == 0 for each in results)


def test_a_symbol_stays_in_its_place_ahead_of_the_car():
    moving = simulation(HIRES, "vehicle.oscillation.pitch_deg=0.5", functions={"way": WAY})
    places = torch.stack([lit_middle(moving, each) for each in moving.evaluations()])
    spread = places.amax(0) - places.amin(0)
    # the car drives 12 m meanwhile, and half a degree of pitch moves light by 5 m there; a row of this camera is 0.9 m long
    assert float(spread[0]) < 0.2 and float(spread[1]) < 0.05


@pytest.mark.parametrize("drives", [False, True])
def test_the_road_of_a_crest_leaves_the_plane_of_the_ground_with_the_square_of_the_distance(drives):
    crest = toml("{ kind = 'profile', grades = [{ x_m = 0, percent = -5, curve_m = 75 }] }")  # a radius of 1500 m
    held = toml("{ kind = 'symbol', image = 'chevrons', controller = 'luxloop' }")
    lamp = {"model": SMALL_LAMP, "lamps": ["left"]}
    vehicle = {"course": [{"speed_m_s": 20.0}]} if drives else None
    symbol = simulation(road=crest, headlight=lamp, vehicle=vehicle, functions={"symbol": held}).symbol
    assert symbol.evaluator is not None
    far_m = symbol.function.x_m + symbol.function.length_m / 2
    if drives:  # the plane touches the road under the rear axle, and its slope, low-passed over 50 m, takes in a part of the curve
        behind = 3.6
        assert -((far_m + behind) ** 2) / 3000 < symbol.evaluator.road_m([0.0, 1.5]) < -0.6 * (far_m + behind) ** 2 / 3000
    else:
        assert symbol.evaluator.road_m([0.0, 1.5]) == pytest.approx(-(far_m**2) / 3000, abs=1e-3)  # the profile's own grid


def test_a_symbol_stays_in_its_place_on_a_steady_climb():
    places = []
    for road in ("flat", "{ kind='profile', grades=[{ x_m=5, percent=5, curve_m=20 }] }"):
        steady = {"vehicle": {"course": [{"speed_m_s": 20.0}]}, "functions": {"way": WAY}}
        moving = simulation(HIRES, f"road={road}" if road[0] == "{" else f"road.kind={road}", "steps=20", **steady)
        places.append(lit_middle(moving, moving.at(16)))  # 64 m: more than half of the window of 50 m beyond the curve
    # the springs have come to rest but for 2 mm, which moves light by 2 mm times 20 m / 0.75 m
    torch.testing.assert_close(*places, rtol=0, atol=0.06)


def test_what_is_found_in_the_image_is_placed_as_the_body_was_measured():
    def gap_m(bias_deg: float) -> float:
        found = (
            "functions.guard.kind=glare_free",
            "detector.kind=truth",
            f"sensors={{fitted=['wheels', 'gyro', 'attitude'], attitude.pitch_bias_deg={bias_deg}}}",
        )
        moving = simulation(*found, objects=[ONCOMING])
        *_, last = moving.evaluations()
        (true,), (found,) = moving._all_objects(last.time_s, None), last.now.objects
        return abs(float(found.T_world_object[0, 3] - true.T_world_object[0, 3]))

    # a row is 1.4 m there, and the box is where the tracker expects it after a period in which the car drives 4 m
    assert gap_m(0.0) < 6 < gap_m(0.3)


def test_functions_learn_speed_and_course_from_the_sensors():
    course = [{"speed_m_s": 10.0, "curvature_1_m": 0.02}, toml("{ time_s = 1.0, speed_m_s = 20.0, curvature_1_m = 0.02 }")]
    moving = simulation(vehicle={"course": course}, sensors={"wheels": {"scale": 1.1}})
    speeds = [each.now.speed_m_s for each in moving.evaluations()]
    assert speeds == pytest.approx([11.0, 12.1, 14.3, 16.5], rel=1e-3)  # means of the period before, which at first has no acceleration
    # the yaw rate knows nothing of a worn tyre
    assert [each.now.curvature_1_m for each in moving.evaluations()] == pytest.approx([0.02 / 1.1] * 4, rel=1e-3)
