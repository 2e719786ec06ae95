"""The documentation tells the truth: commands run, Python runs, TOML is valid, keys and fields are described, links lead somewhere."""

import ast
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Collection
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import reference

from luxloop.loop.commands import cli
from luxloop.loop.commands.options import scenario_of
from luxloop.loop.rig.params import RigParams
from luxloop.loop.scenario.model import Scenario, load, validate
from luxloop.loop.scenario.overrides import TAGS
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.loop.studies.campaign import CampaignParams
from luxloop.loop.studio.page import PAGE
from luxloop.world.lamps import description
from luxloop.world.lamps.description import LampDescription
from luxloop.world.validation import validate_model
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").rglob("*.md"))]

# What is not run here, and why.
EXEMPT = {
    r"make (demo|test|docs|studio)\b": "sets up an environment, and would run this test inside itself",
    r"\. \.venv/bin/activate": "the test runs in an environment already",
    r"python3 -m venv|pip install": "tests/test_packaging.py installs",
    r"(\.venv/bin/)?python benchmarks/": "takes minutes, and has tests of its own",
    r"python train_ppo\.py\b": "takes minutes, and has a test of its own",
    r"python game_engine\.py\b|luxloop run (.*plant\.kind=remote|runs/engine)\b": "needs two programs at once, and has a test of its own",
    r"luxloop rig (calibrate|digitise|fit)\b": "takes minutes, and has tests of its own",
    r"luxloop detect\b": "needs a network of the reader, and has tests of its own",
    r"luxloop rig simulate\b": "serves until it is ended, and has tests of its own",
    r"luxloop (rig (check|blink|take|light)|run .*--rig)\b": "needs a rig; tests/loop/rig/test_page.py has one",
    r"luxloop studio\b": "serves until it is ended, and has tests in a browser",
    r"luxloop run .*--checks": "holds for all steps of a run, and has a test of its own",
    r"luxloop (evaluate|campaign|dataset|optimise-beam|train-detector)\b": "takes minutes, and has tests of its own",
}
# What makes a command cheap without changing what it shows.
QUICK = "--steps 3 --no-video --no-report --set camera.width_px=320 camera.height_px=180"
CHEAP = {
    r"luxloop run snowflake\b": f"{QUICK} headlight.model={SMALL_LAMP}",
    r"luxloop run\b": QUICK,
    r"python tune_gains.py\b": "--trials 1 --steps 3",
    r"luxloop tune\b": "--trials 1 --jobs 1 --set steps=3 camera.width_px=320 camera.height_px=180",
}
CHEAP_PYTHON = {
    '("snowflake", steps=40': '("snowflake", overrides=["camera.width_px=320", "camera.height_px=180", "headlight.model=LAMP"], steps=3',
    '["road.kind=bumps"]': '["road.kind=bumps", "camera.width_px=320", "camera.height_px=180", "headlight.model=LAMP"]',
    '"camera.width_px=640", "camera.height_px=360"': '"camera.width_px=320", "camera.height_px=180", "headlight.model=LAMP"',
    'make_vec("snowflake", 32)': 'make_vec("snowflake", 2, "camera.width_px=320", "camera.height_px=180", "headlight.model=LAMP")',
    "steps=40": "steps=3",
}
FULLY_RUN = ("README",)  # pages whose commands the fast tests run, all of them; of others they run what is quick, or needed on the page
LONG = r"luxloop (run|check|tune|headlight show|export)\b|python "

MEASURED = "|".join(
    ["data get", "opencrg", *(name for name, path in scenario_files().items() if 'kind = "opencrg"' in path.read_text("utf-8"))]
)


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


def commands(page: Path) -> list[str]:
    lines = [line.split(" #")[0].strip() for block in blocks(page, "sh") for line in block.replace("\\\n", " ").splitlines()]
    return [command.strip() for line in lines if line for command in line.split("&&")]


def with_blocks(language: str) -> list[Any]:
    return [pytest.param(page, id=page.stem) for page in PAGES if blocks(page, language)]


def execute(command: str) -> None:
    """Run a command of the documentation in the current folder."""
    if any(re.match(pattern, command) for pattern in EXEMPT):
        return
    cheap = next((flags for pattern, flags in CHEAP.items() if re.match(pattern, command)), "")
    program, *arguments = shlex.split(f"{command} {cheap}")
    if program == "luxloop":
        assert cli.main(arguments) == cli.OK, command
    elif program == "python":
        done = subprocess.run([sys.executable, *arguments], env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
    else:
        pytest.fail(f"{command}: teach this test to run {program!r}, or exempt it with a reason")


def understand(command: str) -> None:
    """Read a command line of luxloop, and the scenario that it would run, without running it."""
    program, *arguments = shlex.split(command)
    if program != "luxloop":
        return
    function, given, _ = cli.app.parse_args(arguments, exit_on_error=False, print_error=False)
    told = given.arguments
    if function in (cli.run, cli.check) and str(told.get("plant")) != "recording":  # whose scenario is in the recording
        values = {key: told[key] for key in ("seed", "steps") if told.get(key) is not None}
        scenario_of(told["name"], told.get("set"), told.get("controller"), allow_code=bool(told.get("allow_code")), **values)


def recording_of(command: str) -> str:
    """The folder into which a `luxloop run` records."""
    out = re.search(r"--out (\S+)", command)
    return out[1] if out else f"runs/{Path(command.split()[2]).stem}"


def run_slowly(language: str, fast: Collection[str] = FULLY_RUN) -> list[Any]:
    """Pages with blocks of a language, of which but a few run in the slow tests alone."""
    return [pytest.param(*each.values, id=each.id, marks=() if each.id in fast else pytest.mark.slow) for each in with_blocks(language)]


@pytest.mark.parametrize("page", run_slowly("sh"))
def test_commands_run_in_the_order_in_which_they_are_read(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in commands(page):
        if not re.search(MEASURED, command):
            execute(command)


@pytest.mark.parametrize("page", [each for each in with_blocks("sh") if each.id not in FULLY_RUN])
def test_commands_are_understood(page, tmp_path, monkeypatch):
    """What the slow test above runs is read at least, with its scenarios; what is quick, or needed by a later command, is run."""
    monkeypatch.chdir(tmp_path)
    todo = [command for command in commands(page) if not re.search(MEASURED, command)]
    for k, command in enumerate(todo):
        needed = command.startswith("luxloop run ") and any(recording_of(command) in later for later in todo[k + 1 :])
        if re.match(LONG, command) and not needed:
            understand(command)
        else:
            execute(command)


@pytest.mark.parametrize("page", [each for each in with_blocks("sh") if any(re.search(MEASURED, c) for c in commands(each.values[0]))])
def test_commands_on_measured_roads_run(page, data_dir, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LUXLOOP_DATA", str(data_dir))
    for command in commands(page):
        if re.search(MEASURED, command):
            execute(command)


@pytest.mark.parametrize("page", run_slowly("python", ("README", "light", "python")))
def test_python_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(blocks(page, "python"))
    for slow, cheap in CHEAP_PYTHON.items():
        code = code.replace(slow, cheap.replace("LAMP", SMALL_LAMP))
    if "luxloop.show(" in code and not (PAGE / "index.html").is_file():
        pytest.skip("the page of the studio is not built; make studio does that")
    if "runs/snowflake" in code:
        execute("luxloop run snowflake")
    for command in commands(page):
        if re.search(r"luxloop (run .*--out runs/(drive|shadow|street)|export light .*npz)", command):
            execute(command)
    exec(compile(code, str(page), "exec"), {"__name__": "docs"})


OWN_PART = re.compile(r"^```python\n((?:(?!```).*\n)*)```\n\nSaved as `(\w+)\.py`(?:.*\n)*?```toml\n((?:(?!```).*\n)*)```", re.M)
OWN_PARTS = [pytest.param(*found, id=found[1]) for page in PAGES for found in OWN_PART.findall(page.read_text("utf-8"))]


@pytest.mark.parametrize(("code", "module", "tables"), OWN_PARTS)
def test_parts_of_ones_own_run(code, module, tables, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / f"{module}.py").write_text(code)
    (keys := tmp_path / "keys.toml").write_text(tables)
    assert f'"{module}:' in tables
    if re.search(r"^\[(detector|functions\.(?!symbol\b))", tables, re.M):
        assert len(list(simulation_of(load("gfhb", [str(keys), "steps=2"], allow_code=True)).evaluations())) == 2
        return
    scenario = load(
        "flat",
        [str(keys), f"headlight.model={SMALL_LAMP}"],
        steps=16,
        camera={"width_px": 640, "height_px": 360, "oversampling": 2},
        allow_code=True,
    )
    *_, last = simulation_of(scenario).evaluations()
    assert last.symbol.measurement.code == 0, "it is seen, by whatever plant"
    metrics = last.symbol.metrics
    assert metrics is None or metrics.iou > 0.7, "each of them brings the symbol to its place, or leaves it there"


HELD = {"symbol": {"kind": "symbol", "image": "snowflake", "controller": "thesis_pid"}}  # of which checks may speak


@pytest.mark.parametrize(
    ("language", "check"),
    [
        ("toml lamp", description.validate),
        ("toml rig", lambda table, page: validate_model(RigParams, table, page)),
        ("toml", lambda table, page: validate({"name": "snippet", "functions": {} if "pixel_gains" in table else HELD, **table}, page)),
    ],
)
def test_snippets_are_valid(language, check):
    for page in PAGES:
        for block in blocks(page, language):
            check(tomllib.loads(block), str(page))


def test_links_lead_somewhere():
    for page in PAGES:
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)", page.read_text("utf-8")):
            file = (page.parent / target).resolve() if target else page
            assert file.exists(), f"{page.name}: {target} does not exist"
            if anchor:
                assert anchor in headings(file), f"{page.name}: {target}#{anchor} does not exist"


def test_the_index_leads_to_every_page_and_the_site_shows_it():
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert {*re.findall(r"\]\(([a-z_/]+\.md)", (ROOT / "docs" / "index.md").read_text("utf-8")), "index.md"} == pages
    assert {*re.findall(r'"([\w/]+\.md)"', (ROOT / "zensical.toml").read_text("utf-8"))} >= pages


def headings(page: Path) -> list[str]:
    titles = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.M)
    return [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]


def test_constants_have_the_values_that_are_written():
    for page in PAGES:
        for module, name, value in re.findall(r"`([a-z_.]+)\.([A-Z_]+) = ([^`]+)`", page.read_text("utf-8")):
            assert repr(getattr(import_module(module), name)) == value, f"{page.name}: {module}.{name}"


def test_pictures_are_small():
    for picture in (ROOT / "docs").rglob("images/*"):
        assert picture.stat().st_size < 400_000, picture.name


@pytest.mark.parametrize("page", reference.FILES)
def test_every_key_of_a_file_is_documented(page):
    text = (ROOT / "docs" / page).read_text("utf-8")
    described = [name for kind, name in reference.MARKED.findall(text) if kind == "keys of"]
    assert sorted(described) == sorted(name for root in reference.FILES[page] for name in reference.models(root))
    assert len(re.findall(r"^\| `", reference.with_tables(text), re.M)) >= len(described)


def test_messages_of_the_studio_are_documented():
    text = reference.with_tables((ROOT / "docs" / "programs.md").read_text("utf-8"))
    assert re.search(r"^\| `hello` \| `token`: text", text, re.M)


FIELDS = [name for page in PAGES for kind, name in reference.MARKED.findall(page.read_text("utf-8")) if kind == "fields of"]


@pytest.mark.parametrize("path", FIELDS)
def test_every_field_is_described(path):
    assert is_dataclass(reference.named(path))
    meanings = reference.described(path)
    for each, field in reference.annotated(path).items():
        assert each in meanings, f"the docstring of {path} does not say what {each} is"
        assert "None" not in ast.unparse(field.annotation) or "None" in meanings[each], f"say when {each} of {path} is None"


def test_every_required_key_has_an_example_for_messages():
    every = [each for root in (Scenario, LampDescription, CampaignParams) for each in reference.models(root).items()]
    required = [(name, key, model["properties"][key]) for name, model in every for key in model.get("required", ())]
    assert [f"{name}.{key}" for name, key, field in required if key not in TAGS and not field.get("examples")] == []
    LampDescription(**{key: field["examples"][0] for name, key, field in required if name == "LampDescription"})
