"""`luxloop new`: templates, copies of what is shipped, and nights of traffic, all valid; what cannot be made is refused."""

import re
import tomllib
from pathlib import Path

import pytest

from luxloop import Scenario, load
from luxloop.loop.scenario.shipped import examples, scenario_files
from tests.loop.conftest import assert_refused


def test_new_scenario_is_valid_and_shows_the_defaults(lux, tmp_path):
    code, out, _ = lux("new", "my.toml")
    assert code == 0 and "luxloop run my.toml" in out
    scenario = load("my.toml")
    assert scenario.name == "my"
    text = (tmp_path / "my.toml").read_text()
    for key in Scenario.model_fields:
        assert re.search(rf"^(# )?(\[+{key}(\.\w+)?\]+|{key} = )", text, re.MULTILINE), key
    everything = re.sub(r"^# (\[\[\w+\]\]|\w+ = (?!\.\.\.))", r"\1", text, flags=re.MULTILINE)
    (tmp_path / "all.toml").write_text(everything)
    tables = tomllib.loads(everything)
    assert len(tables["camera"]) == len(type(scenario.camera).model_fields)
    assert len(tables["functions"]["symbol"]["controller"]) == len(type(scenario.symbol.controller).model_fields)
    assert load("all.toml").model_copy(update={"objects": ()}) == scenario
    assert len(load("all.toml").objects) == 1


@pytest.mark.parametrize("like", scenario_files())
def test_new_scenario_like_a_shipped_one_differs_in_its_name_alone_if_at_all(lux, like):
    assert lux("new", "my.toml", "--like", like)[0] == lux("new", "--like", like)[0] == 0
    assert load("my.toml").model_copy(update={"name": like}) == load(f"{like}.toml") == load(like)


@pytest.mark.parametrize("like", examples())
def test_every_example_can_be_copied_from_where_luxloop_is_installed(lux, like):
    code, out, _ = lux("new", "--like", like)
    assert code == 0 and "first lines" in out
    assert Path(like).read_text("utf-8") == examples()[like].read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("new", "such as my.toml"),
        ("new my.toml --like tune_gains.py", "same ending"),
        ("new --like nothing_like_it", "`luxloop list examples`"),
        ("new --like tune_gain.py", "did you mean 'tune_gains.py'?"),
        ("new my.toml --like gfbh", "'gfhb'"),
        ("new my.toml --traffic -1", "for --traffic; must be >= 0"),
        ("new my.toml --traffic 1 --like gfhb", "one of the two"),
        ("new my.toml --population second", "give --traffic SEED"),
    ],
)
def test_new_that_cannot_be_is_refused(lux, tmp_path, arguments, words):
    assert_refused(lux(*arguments.split()), words)
    assert [each.name for each in tmp_path.iterdir()] == ["small.toml"]


def test_new_night_is_valid_and_its_traffic_comes_from_the_seed(lux):
    assert lux("new", "a.toml", "--traffic", "7")[0] == lux("new", "b.toml", "--traffic", "8")[0] == 0
    a, b = load("a.toml"), load("b.toml")
    assert len(a.all_objects) > 5 and a.all_objects != b.all_objects and a.surface != b.surface
    assert all(each.on_road for each in a.all_objects)
    assert lux("check", "a.toml")[0] == 0


def test_new_night_of_the_second_population_drives_among_models(lux):
    assert lux("new", "a.toml", "--traffic", "7", "--population", "second")[0] == 0
    night = load("a.toml")
    assert {each.kind for each in night.all_objects} == {"model"} and night.vehicle is not None and night.road.kind == "profile"
