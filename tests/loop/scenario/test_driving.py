"""A drive is recorded as overrides of the course and the steps, and no other override is accepted as a drive."""

import pytest

from luxloop import load
from luxloop.loop.scenario.driving import begin_drive, continue_drive, end_drive, repeat, with_drive
from luxloop.loop.scenario.edits import Edit, differences, with_overrides
from luxloop.world.scene.driver import Controls
from tests.refusal import refusal

START = load("night_drive")


def test_overrides_make_the_scenario_that_is_driven_and_edits_repeat_it():
    scenario = begin_drive(START, 3)
    assert with_overrides(START, differences(START, scenario)) == scenario
    assert scenario.all_objects == START.all_objects and scenario.steps == 5
    for step in (3, 4, 5):
        longer, told = continue_drive(scenario, step, Controls(0.7, -1.0))
        assert with_overrides(scenario, told) == longer == repeat(scenario, Edit(step=step, overrides=told, driven=True))
        scenario = longer
    straight, told = end_drive(scenario, 6, 100)
    assert with_overrides(scenario, told) == straight and straight.steps == 100 and straight.all_objects == START.all_objects


def test_what_is_taken_back_keeps_the_drive():
    driven, _ = continue_drive(begin_drive(START, 3), 3, Controls(1.0, 1.0))
    assert with_drive(START, driven) == driven and with_drive(driven, START) is driven


@pytest.mark.parametrize("override", ["functions={}", "vehicle.course[0]={speed_m_s=1.0}", "vehicle.wheelbase_m=3.0", "steps=0"])
def test_nothing_else_passes_for_driving(override):
    with refusal("record the run again"):
        repeat(begin_drive(START, 3), Edit(step=3, overrides=(override,), driven=True))


def test_who_stands_is_not_driven():
    with refusal("the vehicle stands"):
        begin_drive(load("snowflake"), 1)
