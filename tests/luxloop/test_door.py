"""The front door: what it names is there, documented, and imported when it is first used."""

import inspect
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import luxloop
from tests.lamps import SMALL_LAMP
from tests.refusal import refusal

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "scenarios" / "examples").glob("*.py"))]
SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=180"]
UNITS = r"_(m|deg|s|px|cd|percent)$"


def test_import_takes_neither_torch_nor_numpy():
    program = "import sys, luxloop; dir(luxloop); assert not {'torch', 'numpy', 'pydantic'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_a_folder_with_packages_of_the_same_names_changes_nothing(tmp_path):
    for name in ("world", "perception", "controllers", "scenarios"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('of the user')")
    (tmp_path / "loop").mkdir()
    (tmp_path / "loop" / "__init__.py").write_text("raise RuntimeError('of the user')")
    program = "import luxloop; print(luxloop.load('snowflake').name, luxloop.Simulation.__module__)"
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout == "snowflake luxloop.loop.simulation.simulation\n", done.stderr


def test_names_are_documented():
    silent = []
    for name in luxloop.__all__:
        value = getattr(luxloop, name)
        text = inspect.getdoc(value) or ""
        assert value is not None and len(text) > 20, name
        if inspect.isfunction(value):
            known = text + "".join(f" {each}" for each in inspect.signature(value).parameters if re.search(UNITS, each))
            silent += [f"{name}: {each}" for each in inspect.signature(value).parameters if not re.search(rf"\b{each}\b", known)]
    assert not silent, f"say what these are, their shapes and units: {silent}"


def test_dir_is_the_door():
    assert dir(luxloop) == sorted(luxloop.__all__)


def test_unknown_name_gives_the_nearest():
    with pytest.raises(AttributeError, match=r"no attribute 'simulation'; did you mean 'Simulation'\?"):
        _ = luxloop.simulation
    assert not hasattr(luxloop, "torch")


def test_the_version_is_that_of_the_package():
    assert luxloop.__version__ == metadata.version("luxloop")


def test_a_run_shows_its_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = luxloop.run("snowflake", overrides=SMALL, steps=2, video=False)
    assert result.summary["steps"] == result.trajectory.num_rows == 2
    assert result._repr_png_().startswith(b"\x89PNG")
    assert f"folder: {result.folder}" in repr(result)
    folder = result.folder
    assert {path.name for path in folder.iterdir()} == {"manifest.json", "report.png", "summary.json", "trajectory.parquet"}
    del result
    assert not folder.exists() and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_run_of_lighting_functions_goes_where_it_is_sent(tmp_path):
    scenario = luxloop.load("path_projection", [*SMALL, "steps=1"])
    result = luxloop.run(scenario, tmp_path / "path", video=False, report=False)
    assert result.folder == tmp_path / "path" and result._repr_png_() is None
    assert result.trajectory["time_s"].to_pylist() == [0.0]


def test_overrides_of_a_loaded_scenario_are_refused(tmp_path):
    with refusal(r"give them to load\(\)"):
        luxloop.run(luxloop.load("snowflake"), tmp_path / "run", steps=2)
    assert not list(tmp_path.iterdir())


def test_overrides_in_the_place_of_the_folder_are_named():
    with refusal(r"folder is a list, not a path; give other values of keys as overrides=\[\.\.\.\]"):
        luxloop.run("snowflake", ["road.kind=bumps"])  # type: ignore[arg-type]


def test_pages_and_examples_import_from_the_door_or_say_that_they_do_not():
    for page in PAGES:
        text = page.read_text("utf-8")
        inside = re.search(r"^(?:from|import) luxloop\.(?:world|perception|controllers|loop)\b", text, re.M)
        assert bool(inside) == bool(re.search(r"\binternal\b.*\bmay change", text)), f"{page.name} imports internal packages: {inside}"
