"""Scenarios are written as they are read, and told apart in values of keys."""

from itertools import pairwise
from pathlib import Path

import pytest

from luxloop.loop.scenario.edits import differences, with_overrides
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.loop.scenario.text import scenario_text

ALL = [load(name) for name in scenario_files()]


@pytest.mark.parametrize("scenario", ALL, ids=lambda each: each.name)
def test_a_written_scenario_is_read_as_it_was(scenario: Scenario, tmp_path: Path) -> None:
    file = tmp_path / "written.toml"
    file.write_text(scenario_text(scenario), "utf-8")
    assert load(str(file)) == scenario
    assert "description" not in file.read_text("utf-8") or scenario.description  # defaults are left out


@pytest.mark.parametrize(("before", "after"), list(pairwise(ALL)), ids=lambda each: each.name)
def test_differences_make_one_scenario_of_another(before: Scenario, after: Scenario) -> None:
    assert differences(before, before) == ()
    assert with_overrides(before, differences(before, after)) == after


def test_differences_name_the_keys_that_differ() -> None:
    before = load("gfhb")
    after = load("gfhb", ["light.ambient_lx=1.5", "objects[1].albedo=0.5", "functions.guard_traffic={}"])
    told = differences(before, after)
    assert "light.ambient_lx=1.5" in told and "functions.guard_traffic={}" in told
    assert len(told) == 3 and any(each.startswith("objects=[") for each in told)
