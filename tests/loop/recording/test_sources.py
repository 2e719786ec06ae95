"""The files of a module of the user's own are followed as far as they are the user's, and nothing is run for it."""

import sys
from pathlib import Path

import pytest

from luxloop import LuxloopError, load, prepare
from luxloop.loop.recording.manifest import Manifest, digests
from luxloop.loop.recording.sources import sources_of

FILES = {
    "own_pkg/__init__.py": "raise RuntimeError('imported')",
    "own_pkg/roads.py": (
        "import math, torch\nfrom luxloop.world.roads.base import RoadModel\nfrom . import tables\nfrom .deep.waves import wave\n"
    ),
    "own_pkg/tables.py": "def late():\n    import own_helper\n",
    "own_pkg/deep/waves.py": "from ..tables import late\nfrom own_pkg import roads\n",  # a circle, and a package without __init__
    "own_pkg/unused.py": "",
    "own_helper.py": "from os.path import join\n",
    "own_neighbour.py": "",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_imports_are_followed_within_the_folder(folder):
    found = sources_of("own_pkg.roads")
    assert {name: str(file.relative_to(folder)) for name, file in found.items()} == {
        "own_pkg": "own_pkg/__init__.py",
        "own_pkg.roads": "own_pkg/roads.py",
        "own_pkg.tables": "own_pkg/tables.py",
        "own_pkg.deep.waves": "own_pkg/deep/waves.py",
        "own_helper": "own_helper.py",
    }
    assert "own_pkg" not in sys.modules
    assert sources_of("own_neighbour") == {"own_neighbour": folder / "own_neighbour.py"}
    assert sources_of("own_pkg.nothing") == {"own_pkg": folder / "own_pkg/__init__.py"}
    assert sources_of("no_such_module_at_all") == sources_of("luxloop.controllers.pixels.ssc") == sources_of("random") == {}


def test_what_is_not_python_is_said_in_a_sentence(folder):
    (folder / "own_neighbour.py").write_text("def late(:\n")
    with pytest.raises(LuxloopError, match=r"own_neighbour.py: cannot be read as Python .*line 1"):
        sources_of("own_neighbour")


def test_a_replay_says_which_code_has_changed(folder):
    (folder / "own_pkg/__init__.py").write_text("")
    (folder / "own_pkg/roads.py").write_text("from luxloop.world.roads.shapes import Flat\nfrom . import tables\n")
    (folder / "own_pkg/tables.py").write_text("HEIGHT_M = 0.0\n")
    small = ["camera.width_px=320", "camera.height_px=180", "camera.oversampling=2"]
    scenario = load("flat", [*small, "road.kind=own_pkg.roads:Flat"])
    assert set(digests(scenario)) >= {"module own_pkg.roads", "module own_pkg.tables"}
    simulation = prepare(scenario, "cpu")
    before = Manifest.of(scenario, "raycast", simulation.device)
    (folder / "own_pkg/tables.py").write_text("HEIGHT_M = 0.1\n")
    (note,) = before.changes(Manifest.of(scenario, "raycast", simulation.device))
    assert note.startswith("module own_pkg.tables: ") and "has changed since the recording" in note
