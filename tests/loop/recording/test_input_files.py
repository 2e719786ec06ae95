"""The files that decide a run are all found, and what is kept of a run follows them."""

import os
import re
from pathlib import Path

import pytest

from luxloop import LuxloopError, load
from luxloop.loop.recording.manifest import digests, input_files
from luxloop.loop.studies.campaign import job_scenario
from luxloop.loop.studies.objective import parse
from luxloop.loop.studies.runs import figures
from luxloop.loop.studies.tune import Task

SMALL = ["steps=1", "camera={ width_px=160, height_px=90, oversampling=1 }", "functions.symbol={ width_m=4.0, length_m=8.0 }"]
LAMP = """
name = "mine"
[[module]]
name = "matrix"
source = { kind = "folder", path = "pixels", rows = 1, columns = 2 }
[[module]]
name = "spot"
source = { kind = "file", path = "spot.ies" }
[beams.given]
half = { matrix = "half.npy" }
"""


def test_every_file_that_decides_is_an_input(tmp_path, monkeypatch):
    (tmp_path / "pixels").mkdir()
    for name in ("pixels/a.ies", "pixels/b.ies", "spot.ies", "half.npy", "road.crg", "believed.crg"):
        (tmp_path / name).write_text(name)
    (tmp_path / "lamp.toml").write_text(LAMP)
    (tmp_path / "found_by_python.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    road = "{{ kind = 'opencrg', file = '{}' }}"
    model, roads = f"headlight.model={tmp_path / 'lamp.toml'}", [road.format(tmp_path / name) for name in ("road.crg", "believed.crg")]
    believing = load("flat", [model, f"road={roads[0]}", f"functions.symbol.controller={{ name='feedforward', road={roads[1]} }}"])
    found = {os.path.relpath(file, tmp_path): key for key, file in input_files(believing) if file.is_relative_to(tmp_path)}
    lamp = {name: f"headlight.model {name}" for name in ("lamp.toml", "pixels/a.ies", "pixels/b.ies", "spot.ies", "half.npy")}
    assert found == lamp | {"road.crg": "road.file", "believed.crg": "functions.symbol.controller.road.file"}
    own = load("flat", ["functions.symbol.controller={ name='found_by_python:Mine' }"])
    assert dict(input_files(own))["module found_by_python"] == tmp_path / "found_by_python.py"


@pytest.fixture
def symbol(tmp_path: Path) -> Path:
    """A symbol's file; another one has the same name and another width."""
    return drawn(tmp_path, 40)


def drawn(folder: Path, width: int) -> Path:
    file = folder / "mine.svg"
    file.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><rect x="0" y="0" width="100" height="100" fill="black"/>'
        f'<rect x="10" y="20" width="{width}" height="60" fill="white"/></svg>'
    )
    return file


def test_a_changed_symbol_is_another_run(symbol):
    scenario = load("flat", [*SMALL, f"functions.symbol.image={symbol}", "headlight.model=hd84"])
    before, asked, study = figures(scenario, "cpu"), digests(scenario), Task((scenario,), (), parse("iou")).digest
    drawn(symbol.parent, 80)
    assert figures(scenario, "cpu")["utilisation_mean"] > before["utilisation_mean"]  # type: ignore[operator]
    assert Task((scenario,), (), parse("iou")).digest != study
    with pytest.raises(LuxloopError, match=re.escape("flat: functions.symbol.image mine.svg: differs here from the file")):
        job_scenario(scenario.model_dump(mode="json"), asked)
