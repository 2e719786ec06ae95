"""Functions that turn and dim modules: what they command, how fast, and how several come together."""

import math
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from pydantic import ValidationError

from luxloop.controllers.functions.commands import FunctionCommands, compose
from luxloop.controllers.functions.planner import LightingParams, Planner
from luxloop.controllers.situation import Situation
from luxloop.world.headlight.lamp import ModuleCommand

HERE = torch.eye(4, dtype=torch.float64)
LAMPS = torch.tensor([[0.0, 0.6, 0.75]], dtype=torch.float64)
CURVE = {"speed_m_s": 10.0, "curvature_1_m": 0.02}
IN_CURVE_DEG = math.degrees(math.asin(0.02 * 2.0 * 10.0 / 2))  # a chord of 2 s


@dataclass(frozen=True)
class Part:
    name: str
    swivel_deg: tuple[float, float] = (0.0, 0.0)
    level_deg: tuple[float, float] = (0.0, 0.0)


FREE = Part("left free", (-7.0, 15.0), (-1.0, 2.0))
FIXED = Part("right fixed")
BOTH = (FREE, FIXED)


def planner(**functions: Any) -> Planner:
    return Planner.prepare(functions, LightingParams())


def now(time_s: float = 0.0, **known: Any) -> Situation:
    return Situation(time_s, HERE, LAMPS, **known)


def commands(given: Any, *modules: Part) -> tuple[ModuleCommand, ...]:
    return compose(given.values(), modules or BOTH)


def test_bending_swivels_to_where_the_course_is_met_and_leaves_what_cannot():
    for sign in (1, -1):
        given = planner(bend={"kind": "bending"}).command({}, now(speed_m_s=10.0, curvature_1_m=0.02 * sign), BOTH)
        free, fixed = commands(given)
        assert free.swivel_deg == pytest.approx(IN_CURVE_DEG if sign > 0 else -7.0) and fixed == ModuleCommand()
    (far,) = commands(planner(bend={"kind": "bending", "largest_deg": 5.0}).command({}, now(**CURVE), BOTH), FREE)
    assert far.swivel_deg == 5.0


def test_motors_are_no_faster_than_they_can_by_the_clock_of_the_situation():
    """What begins is there; then it turns by its rate, however long a step takes, and goes back to rest as fast."""
    bend = planner(bend={"kind": "bending", "rate_deg_s": 10.0, "stop_s": 3.0})
    turned, given = [], {}
    for time_s in (0.0, 0.1, 0.4, 0.4, 2.0, 3.0, 3.5):
        given = bend.command(given, now(time_s) if time_s == 0 else now(time_s, **CURVE), BOTH)
        turned.append(commands(given, FREE)[0].swivel_deg)
    assert turned == pytest.approx([0.0, 1.0, 4.0, 4.0, IN_CURVE_DEG, IN_CURVE_DEG - 10.0, 0.0])
    assert commands(bend.command({}, now(1.0, **CURVE), BOTH), FREE)[0].swivel_deg == pytest.approx(IN_CURVE_DEG)


def test_a_motor_at_the_end_of_its_range_turns_back_at_once():
    """The right curve wants 11.5 deg of modules that end at 7 and 3; they leave their ends in the step in which the left one begins."""
    narrow = Part("left free narrow", (-3.0, 3.0))
    bend, given, turned = planner(bend={"kind": "bending", "rate_deg_s": 10.0}), {}, []
    for time_s, sign in ((0.0, -1), (1.0, -1), (1.1, 1), (1.2, 1)):
        given = bend.command(given, now(time_s, speed_m_s=10.0, curvature_1_m=0.02 * sign), (FREE, narrow))
        turned.append([each.swivel_deg for each in commands(given, FREE, narrow)])
    assert turned == [pytest.approx(each) for each in ([-7.0, -3.0], [-7.0, -3.0], [-6.0, -2.0], [-5.0, -1.0])]


def test_levelling_and_dimming_follow_the_pitch_and_entries_over_time():
    dim = planner(dim={"kind": "dimming", "entries": [{"time_s": 1.0, "share": 1.0}, {"time_s": 2.0, "share": 0.5}], "stop_s": 5.0})
    shares = [commands(dim.command({}, now(time_s), BOTH), FIXED)[0].intensity for time_s in (0.0, 1.5, 3.0, 5.0)]
    assert shares == pytest.approx([1.0, 0.75, 0.5, 1.0])
    level = {"kind": "levelling", "entries": [{"time_s": 1.0, "level_deg": 0.5}, {"time_s": 3.0, "level_deg": 1.5}]}
    for dynamic, pitch_deg, time_s, expected in (
        (True, 0.0, 0.0, 0.5),
        (True, 0.4, 2.0, 0.6),
        (False, 0.4, 2.0, 1.0),
        (True, 2.0, 9.0, -0.5),
    ):
        given = planner(level=level | {"dynamic": dynamic}).command({}, now(time_s, pitch_rad=math.radians(pitch_deg)), BOTH)
        free, fixed = commands(given)
        assert free.level_deg == pytest.approx(expected) and fixed == ModuleCommand()


def test_turns_add_up_within_the_range_and_intensities_multiply():
    given = {
        "a": FunctionCommands(0.0, tuple((part.name, ModuleCommand(10.0, -0.75, 0.5)) for part in BOTH)),
        "b": FunctionCommands(0.0, ((FREE.name, ModuleCommand(8.0, -0.5, 0.5)), (FIXED.name, ModuleCommand(1.0, 1.0, 0.8)))),
    }
    assert commands(given) == (ModuleCommand(15.0, -1.0, 0.25), ModuleCommand(0.0, 0.0, 0.4))
    assert commands(dict(reversed(given.items()))) == commands(given), "in any order"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"kind": "levelling", "dynamic": False}, "entries: with dynamic = false and no entries nothing is levelled"),
        ({"kind": "dimming", "entries": []}, "entries"),
        ({"kind": "dimming", "entries": [{"share": 1.5}]}, "share"),
        ({"kind": "dimming", "entries": [{"share": 1.0}, {"share": 0.5}]}, "time_s must ascend"),
        ({"kind": "bending", "rate_deg_s": 0.0}, "rate_deg_s"),
        ({"kind": "bending", "start_s": 2.0, "stop_s": 1.0}, "stop_s: 1 is not above start_s"),
        ({"kind": "bending", "value": 1.0}, "value"),
    ],
)
def test_bad_tables_are_refused(given, words):
    with pytest.raises(ValidationError, match=words):
        planner(own=given)


def test_a_module_that_a_function_moves_from_now_on_is_there_at_once():
    one, both = (planner(bend={"kind": "bending", "modules": modules}) for modules in (["right"], ["left", "right"]))
    given = one.command({}, now(**CURVE), (FREE, Part("right free", FREE.swivel_deg)))
    free, _ = commands(both.command(given, now(0.1, **CURVE), BOTH))
    assert free.swivel_deg == pytest.approx(IN_CURVE_DEG)
