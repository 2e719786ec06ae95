"""Other values for a scenario's keys: `--set`, tables, and values beside the file."""

from pathlib import Path

import pytest

from luxloop import load
from luxloop.controllers.functions.path import LaneParams
from luxloop.controllers.symbol.feedback import GaussNewtonParams, ThesisPidParams
from luxloop.controllers.symbol.stages import WarpParams
from luxloop.perception.camera import CameraParams
from luxloop.world.materials.library import SpotParams
from luxloop.world.roads.shapes import Bumps, Flat
from tests.loop.scenario.files import GOOD, SYMBOL, failure
from tests.refusal import refusal


@pytest.mark.parametrize("override", ["steps", "=3", "", "a b=3", "steps.=3"])
def test_override_that_is_no_assignment(file, override):
    assert "--set camera.bits=8" in failure(file, override)


def test_wrong_override_is_shown_beside_the_file(file):
    assert "camera.bitz=8: camera.bitz: unknown key; did you mean 'bits'?" in failure(file, "camera.bitz=8")
    assert "with steps=-3: steps: -3" in failure(file, steps=-3)


def test_a_misspelt_function_is_told_from_a_new_one(file):
    assert "functions.symbl: there is no function 'symbl'; did you mean 'symbol'?" in failure(file, "functions.symbl.width_m=1.5")
    for overrides in (["functions.symbl.kind=glare_free"], ["functions.symbl.margin_m=0.5", "functions.symbl.kind=glare_free"]):
        assert set(load(str(file), overrides).functions) == {"symbol", "symbl"}


def test_overrides_win_over_the_file_and_keep_the_rest(file):
    scenario = load(str(file), ["camera.bits=8", "camera.gamma=2.2", "name=other", "functions.symbol.width_m=1.5"], steps=7)
    assert (scenario.camera.bits, scenario.camera.gamma, scenario.name, scenario.steps) == (8, 2.2, "other", 7)
    assert (scenario.symbol.image, scenario.symbol.width_m) == ("snowflake", 1.5)


def test_another_variant_starts_anew_whatever_the_order(file):
    file.write_text(GOOD + '[road]\nkind = "speed_bump"\nheight_m = 0.05\n')
    for overrides in (["road.kind=bumps", "road.seed=5"], ["road.seed=5", "road.kind=bumps"]):
        road = load(str(file), overrides).road
        assert (road.kind, road.seed) == ("bumps", 5)
    assert load(str(file), ["road.kind=speed_bump"]).road.height_m == 0.05


def test_paths_are_relative_to_the_file_and_overrides_to_the_working_folder(file, monkeypatch):
    file.write_text(GOOD.replace('"snowflake"', '"mine.png"') + '[road]\nkind = "opencrg"\nfile = "../scan.crg"\n')
    scenario = load(str(file))
    assert scenario.symbol.image == str(file.parent / "mine.png")
    assert Path(scenario.road.file) == file.parent.parent / "scan.crg"
    (file.parent / "here").mkdir()
    monkeypatch.chdir(file.parent / "here")
    assert load(str(file), ["functions.symbol.image=other.png"]).symbol.image == str(file.parent / "here" / "other.png")


def test_a_controller_given_beside_the_file_is_that_of_the_only_symbol_held(file):
    assert load(str(file), controller={"name": "thesis_pid"}).symbol.controller == ThesisPidParams()
    file.write_text(SYMBOL)
    assert "controller: none of its functions has one" in failure(file, controller={"name": "open"})
    file.write_text(GOOD + GOOD[GOOD.index("[") :].replace("functions.symbol", "functions.other"))
    message = failure(file, controller={"name": "open"})
    assert "controller: several symbols have one: symbol, other; set functions.NAME.controller" in message


def test_one_key_of_one_item_of_a_list_can_be_set(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = load("marker_light")
    sets = [
        "functions.pedestrian_light.value=0.25",
        "functions.guide_line.animation.rate_hz=3",
        "objects[0].track[1].position_m=[30, 0, 0]",
    ]
    now = load("marker_light", sets)
    line, body = now.functions["guide_line"], now.functions["pedestrian_light"]
    assert body == before.functions["pedestrian_light"].model_copy(update={"value": 0.25})
    assert line.animation.rate_hz == 3 and line.width_m == 0.35  # type: ignore[union-attr]
    assert [key.position_m[1] for key in now.objects[0].track] == [-4.5, 0]
    assert load("obl", ["functions.object_light.method=constant"]).functions["object_light"].method == "constant"  # type: ignore[union-attr]
    shown = load("animated_symbol", ["functions.guidance.image=./own.png"])
    assert shown.functions["guidance"].image == str((tmp_path / "own.png").resolve())  # type: ignore[union-attr]
    assert not load("marker_light", ["objects={}"]).objects and not load("marker_light", ["objects=[]"]).objects


def test_an_item_one_beyond_the_last_is_added():
    there = load("marker_light").spots
    overrides = [f"spots[{len(there) + k}]={{x_m={20.0 + k}}}" for k in range(2)]
    assert load("marker_light", overrides).spots == (*there, SpotParams(x_m=20.0), SpotParams(x_m=21.0))
    assert load("marker_light", [{"spots": {f"[{len(there)}]": {"x_m": 20.0}}}]).spots == (*there, SpotParams(x_m=20.0))


IMPOSSIBLE = {
    "objects[2].albedo=1": r"^objects\[2\]: there are 1 objects, numbered from 0",
    "functions.guide_line.valeu=1": r"functions.guide_line.valeu: unknown key; did you mean 'value'",
    "functions.''.kind=lane": r"functions\..*: '' is not a valid name",
    "objects.0.albedo=1": r"^objects: is a list and has no '0'; write --set 'objects\[0\].KEY",
    "objects[0].track[7].time_s=1": r"^objects\[0\].track\[7\]: there are \d+ track, numbered from 0",
    "objects[1].albedo=1": r"objects\[1\].kind: is missing",
    "objects[1]={}": r"^objects\[1\]: there are 1 objects, numbered from 0",
    "headlight.lamps[2]=left": r"lamps\[2\]: there are 2 lamps, numbered from 0",
}


@pytest.mark.parametrize(("override", "words"), IMPOSSIBLE.items())
def test_an_item_that_cannot_be_is_refused(override, words):
    with refusal(words):
        load("marker_light", [override])


@pytest.mark.parametrize(
    ("name", "overrides", "key", "left"),
    [
        ("snowflake", ["road={}"], "road", Flat()),
        ("snowflake", ["road.seed=5", "camera={}", "road.kind=bumps"], "road", Bumps(seed=5)),
        ("flat", ["functions.symbol.controller={}", "functions.symbol.start={}"], "symbols", {}),
        ("snowflake", ["camera={}", "camera.bits=8"], "camera", CameraParams(bits=8)),
        ("gfhb", ["functions.guard_traffic={}"], "functions", {}),
        ("gfhb", ["functions.guard_traffic={}", "functions.carpet.kind=lane"], "functions", {"carpet": LaneParams()}),
        ("gfhb", ["functions.guard_traffic.kind=lane"], "functions", {"guard_traffic": LaneParams()}),
        ("driving", ["vehicle={}"], "vehicle", None),
        ("snowflake", [{"traffic": {"seed": 3}}, {"traffic": {}}], "traffic", None),
        ("marker_light", ["objects[0]={}"], "objects", ()),
    ],
)
def test_an_empty_table_clears_what_is_there(name, overrides, key, left):
    assert getattr(load(name, overrides), key) == left


def test_an_empty_table_in_one_that_starts_anew_has_its_defaults():
    controller = 'functions.symbol.controller={name="gauss_newton", warp={}}'
    assert load("speed_bump", [controller]).symbol.controller == GaussNewtonParams(warp=WarpParams())
    assert load("speed_bump", [controller, "functions.symbol.controller.warp={}"]).symbol.controller == GaussNewtonParams()
