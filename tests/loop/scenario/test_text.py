"""Scenarios are written as they are read, and told apart in values of keys."""

import pytest

from luxloop import load
from luxloop.loop.scenario.edits import differences, with_overrides
from luxloop.loop.scenario.shipped import TEMPLATE, copy_text, scenario_files
from luxloop.loop.scenario.text import scenario_text
from tests.loop.scenario.template import template

ALL = [load(name) for name in scenario_files()]


@pytest.mark.parametrize(("scenario", "other"), list(zip(ALL, [*ALL[1:], ALL[0]], strict=True)), ids=lambda each: each.name)
def test_a_written_scenario_is_read_as_it_was_and_made_of_another(scenario, other, tmp_path):
    file = tmp_path / "written.toml"
    file.write_text(scenario_text(scenario), "utf-8")
    assert load(str(file)) == scenario
    assert "description" not in file.read_text("utf-8") or scenario.description  # defaults are left out
    assert differences(scenario, scenario) == () and with_overrides(other, differences(other, scenario)) == scenario


def test_differences_name_the_keys_that_differ():
    before = load("gfhb")
    found = differences(before, load("gfhb", ["light.ambient_lx=1.5", "objects[4].albedo=0.5", "functions.guard_traffic={}"]))
    assert len(found) == 3 and {"light.ambient_lx=1.5", "functions.guard_traffic={}"} < set(found)
    assert any(each.startswith("objects=[") for each in found)


def test_the_template_is_that_of_the_model_and_a_copy_has_its_own_name():
    assert TEMPLATE.read_text("utf-8") == template(), "python -m tests.loop.scenario.template"
    assert copy_text(TEMPLATE, 'mine "1"').splitlines()[5] == 'name = "mine \\"1\\""  # name, for tables and reports'
