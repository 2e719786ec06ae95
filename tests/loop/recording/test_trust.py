"""A file runs no code unless the user says so, whichever file it is; what the user types is trusted."""

import json
import sys
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import pytest

from luxloop import LuxloopError, load, run
from luxloop.loop.commands import cli
from luxloop.loop.recording.manifest import MANIFEST, Manifest, digests
from luxloop.loop.recording.replay import replay
from luxloop.loop.studies import campaign
from luxloop.world import plugin
from tests.refusal import refusal

MINE = """
from pathlib import Path

Path(__file__).with_name("mark").touch()

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.perception import extraction
from luxloop.world.roads.shapes import Flat

class Road(Flat):
    pass

class Looks:
    def symbol_image(self, contrast, limit):
        return extraction.symbol_image(contrast, limit, extraction.ExtractionParams())

class Stays:
    def __init__(self, sensor, fails=False):
        self.fails = fails
    def start(self, pose):
        return pose
    def projection(self, state, ego):
        return ProjectionCommand(state)
    def step(self, state, observation):
        return 1 / 0 if self.fails else state
"""
BARE = """
name = "mine"
renderer = "raycast"
steps = 1
camera = { width_px = 160, height_px = 90, oversampling = 1 }
headlight = { model = "hd84", lamps = ["left"] }
"""
SYMBOL = BARE + "".join(
    f"functions.symbol.{line}\n" for line in ('kind = "symbol"', 'image = "snowflake"', "width_m = 4.0", "length_m = 8.0")
)
HELD = SYMBOL + 'functions.symbol.controller = "luxloop"\n'
NAMING = {
    "road.kind": HELD + 'road = { kind = "mine:Road" }',
    "functions.symbol.controller.name": SYMBOL + 'functions.symbol.controller = { name = "mine:Stays" }',
    "functions.symbol.controller.road.kind": SYMBOL
    + 'functions.symbol.controller = { name = "feedforward", road = { kind = "mine:Road" } }',
    "functions.symbol.extraction.kind": HELD + 'functions.symbol.extraction = { kind = "mine:Looks" }',
    "pixel_controller": HELD + 'pixel_controller = "mine:Stays"',
    "plant.kind": HELD + 'plant = { kind = "mine:Stays" }',
    "detector.kind": BARE + 'detector = { kind = "mine:Looks" }',
    "functions.mine.kind": BARE + 'functions.mine = { kind = "mine:Looks" }',
    "tracker.kind": BARE + 'detector = { kind = "truth" }\ntracker = { kind = "mine:Looks" }',
}


@pytest.fixture(autouse=True)
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with scenarios and their module, which leaves a mark where it runs; the user is elsewhere."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "mine.py").write_text(MINE)
    (folder / "plain.toml").write_text(HELD)
    monkeypatch.chdir(tmp_path)
    return folder


def ran(folder: Path) -> bool:
    return (folder / "mark").exists()


@pytest.mark.parametrize(("key", "text"), NAMING.items(), ids=NAMING)
def test_a_scenario_runs_no_code_unless_that_is_allowed(key, text, mine):
    (file := mine / "scenario.toml").write_text(text)
    with pytest.raises(LuxloopError) as caught:
        load(str(file))
    for part in (f"{file}: {key}: ", "the module mine;", "--allow-code", "allow_code=True"):
        assert part in str(caught.value), caught.value
    scenario = load(str(file), allow_code=True)
    ((found, name),) = plugin.own_names(scenario)
    assert (found, name.folder, name.module) == (key, mine, "mine")
    assert digests(scenario)["module mine"] and not ran(mine), "even so, nothing runs before it is needed"


@pytest.mark.parametrize("key", NAMING)
def test_what_is_typed_or_given_in_python_is_the_users_own(key, mine, monkeypatch):
    """`--controller` comes in values; the module is found where the user is."""
    monkeypatch.chdir(mine)
    base = {"detector.kind": "gfhb", "functions.mine.kind": "gfhb", "tracker.kind": "obl"}.get(key, "flat")
    name = NAMING[key].rpartition("mine:")[2].partition('"')[0]
    sets = [f"{key}=mine:{name}"]
    if key == "functions.symbol.controller.road.kind":
        sets = [f"functions.symbol.controller={{ name='feedforward', road={{ kind='mine:{name}' }} }}"]
    assert [each for _, each in plugin.own_names(load(base, sets))] == [f"{mine}/mine:{name}"]
    if key == "functions.symbol.controller.name":
        assert load(base, controller={"name": f"mine:{name}"}).symbol.controller.name == f"{mine}/mine:{name}"
    (mine / "keys.toml").write_text("[road]\nkind = 'mine:Road'\n")
    with refusal(r"road\.kind: .*--allow-code"):
        load(base, ["keys.toml"])
    assert load(base, ["keys.toml"], allow_code=True).road.kind == f"{mine}/mine:Road"


def test_a_name_in_a_file_stays_untrusted_beside_what_is_typed(mine):
    (file := mine / "scenario.toml").write_text(NAMING["functions.symbol.extraction.kind"])
    with refusal(r"extraction\.kind: .*--allow-code"):
        load(str(file), ["road.kind=bumps", "functions.symbol.extraction.area_low=0.3"])
    assert load(str(file), ["functions.symbol.extraction.kind=differential"]).symbol.extraction.kind == "differential"


def recorded(mine: Path, text: str, key: str, value: Any) -> Path:
    """A recording in whose manifest a key of the scenario was edited."""
    (mine / "plain.toml").write_text(text)
    scenario = load(str(mine / "plain.toml"))
    run(scenario, mine / "run", device="cpu", video=False, report=False)
    manifest = json.loads((mine / "run" / MANIFEST).read_text())
    *tables, last = key.split(".")
    reduce(getitem, tables, manifest["scenario"])[last] = value
    (mine / "run" / MANIFEST).write_text(json.dumps(manifest))
    return mine / "run"


@pytest.mark.parametrize(("text", "table", "name"), [(HELD, "functions.symbol.extraction", "Looks"), (BARE, "road", "Road")])
def test_an_edited_manifest_runs_no_code(text, table, name, mine, capsys):
    directory = recorded(mine, text, table, {"kind": f"{mine}/mine:{name}"})
    with refusal(rf"manifest\.json: {table}\.kind: .*the module mine;.*--allow-code"):
        replay(directory)
    assert cli.main(["replay", str(directory)]) == cli.WRONG and not ran(mine)
    assert replay(directory, allow_code=True).agrees and ran(mine), "the manifest knows where the module was"
    assert "the scenario in the manifest was edited" in " ".join(Manifest.read(directory).changes(Manifest.read(directory)))


def test_a_campaign_names_code_as_a_scenario_does(mine):
    for text in ('controllers = ["mine:Stays"]', "[set.road]\nkind = 'mine:Road'", "[variants.a]\nroad.kind = 'mine:Road'"):
        (file := mine / "campaign.toml").write_text(f'scenarios = ["plain.toml"]\n{text}\n')
        with refusal(r"the module mine;.*--allow-code"):
            campaign.read(file)
        (one,) = campaign.read(file, allow_code=True)
        job = campaign.job_scenario(one.scenario.model_dump(mode="json"), digests(one.scenario))
        assert [name.folder for _, name in plugin.own_names(job)] == [mine], "workers have the decision with the name"
    (mine / "plain.toml").write_text(NAMING["road.kind"])
    file.write_text('scenarios = ["plain.toml"]\n')
    with refusal(r"plain\.toml: road\.kind: .*--allow-code"):
        campaign.read(file)
    assert not ran(mine)


def test_a_step_that_fails_says_where_and_debug_shows_how(mine, capsys):
    (file := mine / "scenario.toml").write_text(
        SYMBOL + 'functions.symbol.controller = { name = "mine:Stays", options = { fails = true } }'
    )
    line = 1 + MINE.splitlines().index("        return 1 / 0 if self.fails else state")
    command = ["run", str(file), "--allow-code", "--no-video", "--no-report", "--device", "cpu"]
    assert cli.main(command) == cli.WRONG
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.endswith(f"mine:Stays: step fails at {mine}/mine.py, line {line} (ZeroDivisionError: division by zero)"), told
    assert cli.main(["--debug", *command]) == cli.WRONG
    shown = capsys.readouterr().err
    assert "Traceback" in shown and f'File "{mine}/mine.py", line {line}, in step' in shown and told in shown
