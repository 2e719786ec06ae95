"""The command line: what lists, checks, help and messages say, every way to be wrong in one sentence and with its exit code."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from luxloop import load, run
from luxloop.loop.commands import cli
from luxloop.loop.scenario import data, listing
from luxloop.world.opencrg import Crg
from tests.loop.conftest import FILE, assert_refused
from tests.world.opencrg.writer import write_crg

ROOT = Path(__file__).parents[3]
# What only a picture, a report, an object or a detector needs: each takes a tenth of a second or more.
LOOKING = (
    "kornia", "matplotlib", "networkx", "onnxruntime", "optuna", "pandas", "pyglet", "pyrender", "trimesh",
    "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.spatial", "scipy.stats",
)  # fmt: skip


LISTED = {
    "scenarios": {"snowflake", "gfhb"},
    "functions": {"symbol", "glare_free", "lane", "marker"},
    "controllers": {"luxloop", "open", "thesis_pid"},
    "roads": {"flat", "opencrg"},
    "symbols": {"chevrons"},
    "detectors": {"network", "truth"},
    "lamps": {"ssl-hd"},
    "plants": {"simulated", "recording"},
    "examples": {"night.toml", "tune_gains.py"},
}


@pytest.mark.parametrize(("kind", "some"), LISTED.items())
def test_each_kind_is_listed_for_people_and_for_programs(lux, kind, some):
    code, out, _ = lux("list", kind)
    assert code == 0 and all(name in out for name in some)
    listed = {each["name"]: each for each in json.loads(lux("list", kind, "--json")[1])}
    assert some <= set(listed) and "package.module:Name" not in listed
    keys = {"name", "description", "uses", "lacks"} if kind == "scenarios" else {"name", "description"}
    assert all(set(each) == keys and each["description"] for each in listed.values())


def test_scenarios_are_listed_with_their_controllers_and_other_functions(lux):
    uses = {each["name"]: each["uses"] for each in json.loads(lux("list", "--json")[1])}
    assert uses["snowflake"] == ["thesis_pid"] and uses["gfhb"] == ["glare_free"]
    assert uses["held_on_the_move"] == ["luxloop", "glare_free", "object_based"]


def test_check_and_tune_take_a_controller(lux):
    assert "symbol (symbol, held by thesis_pid)" in lux("check", "small.toml", "--controller", "thesis_pid")[1]
    assert_refused(lux("check", "small.toml", "--controller", "thesis_pdi"), "did you mean 'thesis_pid'?")
    line = "tune small.toml --key functions.symbol.controller.position.kp=0.1:1 --trials 2 --jobs 1 --device cpu"
    assert_refused(lux(*line.split()), "functions.symbol.controller.position")  # luxloop has no such key
    code, out, _ = lux(*line.split(), "--controller", "thesis_pid")
    assert code == 0 and ("--controller thesis_pid --set" in out or "no trial is better" in out)


def test_check_for_programs_says_what_was_found_and_what_is_wrong(lux):
    def checked(*arguments: str) -> dict[str, Any]:
        code, out, error = lux("check", *arguments, "--json")
        found = json.loads(out)
        assert (code, error) == ((0, "") if found["ok"] else (cli.WRONG, f"error: {found['error']}\n"))
        return found

    assert checked("small.toml") == {
        **{"scenario": "small.toml", "ok": True, "steps": 3, "road": "flat", "base": "base beam off", "functions": {"symbol": "symbol"}},
        **{"controllers": {"symbol": "luxloop"}, "objects": 0, "detector": None, "notes": []},
    }
    found = checked("gfhb", "--set", "headlight.model=hd84", "renderer=raycast")
    expected = {"functions": {"guard_traffic": "glare_free"}, "objects": 5, "detector": None, "controllers": {}}
    assert {key: found[key] for key in expected} == expected
    assert not checked("small.toml", "--set", "camera.bitz=8")["ok"]


def test_check_says_how_much_of_a_target_the_lamps_cannot_reach(lux):
    code, out, _ = lux("check", "small.toml", "--set", "functions.symbol.x_m=12.0")
    note = re.search(r"\nnote: (\d+) % of the target of functions.symbol lies beyond the lower border of the lamps' field; (.*)\n$", out)
    assert code == 0 and note and note[2] == "raise functions.symbol.x_m"
    done = run(load("small.toml", ["functions.symbol.x_m=12.0"], steps=1, controller={"name": "open"}), video=False, report=False)
    assert int(note[1]) == pytest.approx(100 * done.summary["functions"]["symbol"]["cut"], abs=0.5)  # it is shown there, and rounded


@pytest.mark.parametrize(
    ("command", "heavy"),
    [
        (["--help"], ("numpy", "torch", "pydantic")),
        (["new", "my.toml"], ("numpy", "torch", "pydantic")),
        (["check", "snowflak"], ("numpy", "torch", "pydantic")),
        (["check", "snowflake"], LOOKING),
        (["check", "driving"], [each for each in LOOKING if "scipy" not in each]),  # whose vehicle moves on filters of SciPy
    ],
    ids=" ".join,
)
def test_command_imports_nothing_heavy_that_it_does_not_use(command, heavy, tmp_path):
    program = f"import sys\nfrom luxloop.loop.commands import cli\ncli.main({command})\nprint(sorted({set(heavy)} & set(sys.modules)))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("command", ["check", "run", "check --json"])
def test_several_errors_have_a_line_each(lux, command):
    code, _, error = lux(*command.split(), "small.toml", "--set", "camera.bits=9", "road.kind=bumpz", "steps=0")
    assert code == 2
    first, *lines = error.splitlines()
    assert first.startswith("error: small.toml with camera.bits=9") and first.endswith(": 3 errors")
    assert sorted(line.partition(":")[0] for line in lines) == ["  camera.bits", "  road.kind", "  steps"]


MENDED = {  # what is said of a command line, in parts
    "rum small.toml": "did you mean 'run'?",
    "data gett x": "did you mean 'get'?",
    "run GFBH": "did you mean 'gfhb'?",
    "data get belgian_blok": "did you mean 'belgian_block'?",
    "run small.toml --sede 3": "did you mean --seed?",
    "run small.toml --device cpuu": 'did you mean "cpu"?',
    "run small.toml --controller thesis_pdi": "did you mean 'thesis_pid'?",
    "run small.toml --set camera.bitz=8": "did you mean 'bits'?",
    "run small.toml --set functions.symbol.image=snowflak": "did you mean 'snowflake'?",
    "run small.toml --set road.kind=bumpz": "did you mean 'bumps'?",
    "run": "NAME",
    "run small.toml another": "another | luxloop run --help",
    "run small.toml --steps three": "--steps | three",
    "run small.toml --steps -1": "steps=-1 | greater than or equal to 1",
    "run small.toml --seed -1": "seed=-1 | greater than or equal to 0",
    "run small.toml --set steps": "--set steps | key=value",
    "run small.toml --set camera.bits=[8": "camera.bits | '[8'",
    "run nothing.toml": "nothing.toml | luxloop new",
    "run .": "folder",
    "run nonexist": "no scenario 'nonexist'; `luxloop list` shows",
    "nonexist": "no command 'nonexist'; `luxloop --help` shows",
    "data nonexist": "no command 'nonexist'; `luxloop data --help` shows",
    "run small.toml --out small.toml": "small.toml | --out",
    "run small.toml --out .": "no recording | new directory",
    "run small.toml --set road.kind=mixed road.bumps_m=[-0.1,-0.1]": "road.bumps_m[1] | -0.1 | greater than or equal to 0",
    "run small.toml --set functions.symbol.image=none.png": "none.png | does not exist",
    "run small.toml --set functions.symbol.image=black.png": "black.png",
    "run small.toml --set functions.symbol.image=text.png": "text.png | picture",
    "run small.toml --set functions.symbol.image=empty.png": "empty.png | picture",
    "run small.toml --set road.kind=opencrg road.file=none.crg": "none.crg | check the path",
    "run small.toml --set road.kind=opencrg road.file=text.png": "text.png | OpenCRG",
    "run small.toml --set road.kind=opencrg road.file=short.crg": "short.crg | truncated",
    "run mesh.toml --set road.kind=flat": "none.obj | No such file",
    "run badmesh.toml": "text.stl | triangles",
    "run small.toml --set camera.yaw_deg=90": "functions.symbol: the target at x_m = 17 | camera's view",
    "run small.toml --set functions.symbol.y_m=-9 camera.yaw_deg=-26": "functions.symbol: the target at x_m = 17, y_m = -9 | lamps' reach",
    "run small.toml --set headlight.intensity_cd=1": "noise | headlight.intensity_cd",
    "check small.toml --set headlight.model=hd84": "noise | left matrix | 6.73 x 0.6 | finer pixels",
    "check small.toml --set a=1": "a: unknown key",
    "check small.toml --set symbol.image=chevrons": "symbol: unknown key | [functions.NAME]",
    "check gfhb --controller open": "controller: none of its functions has one",
    "check two_symbols --controller open": "controller: several symbols have one: flake, way; set functions.NAME.controller",
    "schema --kind symbol": "--kind",
    "check mesh.toml": "none.obj",
    "replay .": "no recording | luxloop run",
    "replay nowhere": "nowhere | luxloop run",
    "new small.toml": "small.toml | exists",
    "new nowhere/my.toml": "nowhere/my.toml | folder",
}


@pytest.mark.parametrize(("arguments", "named"), MENDED.items())
def test_what_the_user_can_mend_is_one_sentence_and_leaves_nothing_behind(lux, tmp_path, arguments, named):
    cv2.imwrite("black.png", np.zeros((8, 8), np.uint8))
    Path("text.png").write_text("no picture")
    Path("empty.png").touch()
    Path("text.stl").write_text("no mesh")
    write_crg("short.crg", Crg(np.zeros((50, 5)), np.linspace(-2, 2, 5), {"reference_line_increment": 1.0, "reference_line_end_u": 49.0}))
    Path("short.crg").write_bytes(Path("short.crg").read_bytes()[:-501])
    objects = '[[objects]]\nkind = "mesh"\nname = "m"\nfile = "{}"\ntrack = [{{position_m = [17, 0, 0]}}]\n'
    Path("mesh.toml").write_text(FILE + objects.format("none.obj"))
    Path("badmesh.toml").write_text(FILE + objects.format("text.stl"))
    before = set(tmp_path.rglob("*"))
    assert_refused(lux(*arguments.split()), *named.split(" | "))
    assert set(tmp_path.rglob("*")) == before


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device here")
def test_device_that_is_not_there(lux):
    assert_refused(lux("run", "small.toml", "--device", "cuda"), "device cuda", "cpu")


def test_check(lux):
    code, out, error = lux("check", "small.toml", "--set", "steps=5")
    assert (code, error) == (0, "")
    assert out == "small.toml: ok (5 steps, road flat, base beam off, functions symbol (symbol, held by luxloop), 0 objects, no detector)\n"


def test_schema_is_json(lux):
    code, out, _ = lux("schema")
    found = json.loads(out)
    assert code == 0 and found["required"] == ["name"] and found["properties"]["steps"]["minimum"] == 1
    assert {"functions", "lighting"} <= set(found["properties"]) and "image" in found["$defs"]["SymbolFunctionParams"]["required"]


def test_list_names_missing_data_and_how_to_get_it(lux, tmp_path, monkeypatch):
    paved = tmp_path / "paved.toml"
    symbol = 'functions.symbol = {kind = "symbol", image = "snowflake", controller = "open"}\n'
    paved.write_text('name = "paved"\ndescription = "On stones."\nroad = {file = "belgian_block"}\n' + symbol)
    monkeypatch.setattr(listing, "scenario_files", lambda: {"paved": paved})
    monkeypatch.setenv("LUXLOOP_DATA", str(tmp_path))
    monkeypatch.setattr(data, "cache_folder", lambda: tmp_path / "cache")
    code, out, _ = lux("list")
    assert code == 0
    for part in ("paved", "open", "On stones.", "luxloop data get belgian_block"):
        assert part in out
    (tmp_path / "belgian_block.crg").touch()
    (tmp_path / data.entry("belgian_block").file).parent.mkdir(exist_ok=True)
    (tmp_path / data.entry("belgian_block").file).touch()
    assert "luxloop data get" not in lux("list")[1]


def test_data_commands(lux, tmp_path, monkeypatch):
    fetched: list[tuple[str, Path | None]] = []

    def get(name: str, directory: Path | None = None) -> data.Download:
        fetched.append((data.entry(name).name, directory))
        return data.Download(tmp_path / name, downloaded=name != "Barber")

    monkeypatch.setattr(data, "get", get)
    code, out, _ = lux("data", "list")
    assert code == 0 and all(name in out for name in data.registry())
    code, out, _ = lux("data", "get", "Barber", "--dir", "here")
    assert code == 0 and "was here" in out
    assert fetched == [("Barber", Path("here"))]
    assert lux("data", "get", "all")[0] == 0
    assert len(fetched) == 1 + len(data.registry())


def test_the_working_folder_runs_no_code(tmp_path):
    """Neither in the workers of a campaign nor by what draws its report; Jupyter's backend of Matplotlib is not asked for."""
    ran = tmp_path / "ran"
    for name in ("joblib.py", "threading.py", "torch.py"):
        (tmp_path / name).write_text(f"open({str(ran)!r}, 'w')\n")
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    (tmp_path / "latex").write_text(f"#!/bin/sh\ntouch {ran}; exit 1\n")
    (tmp_path / "latex").chmod(0o755)
    small = 'headlight.model = "hd84"\ncamera = { width_px = 160, height_px = 90, oversampling = 1 }\nrenderer = "raycast"\n'
    small += "functions.symbol = { width_m = 4.0, length_m = 8.0 }\n"
    (tmp_path / "c.toml").write_text(
        f'scenarios = ["snowflake"]\nseeds = [1]\ncontrollers = ["open", "luxloop"]\n[set]\nsteps = 1\n{small}'
    )
    program = "import sys; sys.path.pop(0); from luxloop.loop.commands.cli import main; sys.exit(main())"  # the first is what -c adds
    there = {"PYTHONPATH": str(ROOT), "PATH": f"{tmp_path}:{os.environ['PATH']}", "MPLBACKEND": "module://no_such.backend"}
    command = [sys.executable, "-c", program, "campaign", "c.toml", "--jobs", "2"]
    done = subprocess.run(command, cwd=tmp_path, env={**os.environ, **there}, capture_output=True, text=True)
    assert (done.returncode, ran.exists()) == (0, False), done.stderr


def test_process_starts_quickly_and_takes_a_closed_pipe_calmly():
    """What help and lists import is what makes them slow: torch alone takes a second."""
    program = (
        "import sys; from luxloop.loop.commands.cli import main\n"
        "assert main(['--help']) == 0 and main(['list']) == 0 and main(['data', 'list']) == 0\n"
        "assert not {'torch', 'kornia', 'matplotlib', 'pyrender', 'trimesh', 'pandas'} & set(sys.modules)\n"
        "sys.exit(main(['data', 'lits']))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    with subprocess.Popen(
        [sys.executable, "-m", "luxloop.loop.commands.cli", "data", "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1
