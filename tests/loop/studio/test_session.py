"""Edits of a run in the studio: taken back, saved, recorded, and made in the scenario's file."""

import json
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from luxloop import load
from luxloop.loop.recording.manifest import REPORT, SUMMARY
from luxloop.loop.recording.replay import load as recording
from luxloop.loop.recording.replay import replay
from luxloop.loop.scenario.text import scenario_text
from luxloop.loop.studio.runs import start
from luxloop.loop.studio.session import TOGETHER_S
from luxloop.loop.studio.sources import Source
from tests.loop.studio.clients import Watcher
from tests.loop.studio.conftest import SMALL, Served, serving

KP = "functions.symbol.controller.position.kp"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario's file of somebody's own."""
    path = tmp_path_factory.mktemp("own") / "own.toml"
    path.write_text(scenario_text(load("snowflake", [*SMALL, "steps=30", "judge_every=0"])))
    return path


@pytest.fixture(scope="module")
def served(file: Path, page_folder: Path) -> Iterator[Served]:
    yield from serving(Source(str(file)), page_folder)


@pytest.fixture
def editor(editor: Watcher) -> Watcher:
    """At the first step."""
    editor.reset()
    editor.of("step", step=0)
    return editor


def kp(served: Served) -> float:
    return float(served.run.simulation.symbol.params.position.kp)  # type: ignore[union-attr]


def test_an_edit_tells_the_model_and_what_the_page_must_know(served, editor):
    edit = editor.set("light.ambient_lx=2.5", f"{KP}=0.4")
    assert edit["model"]["light"]["ambient_lx"] == 2.5 and edit["facts"]["ambient_lx"] == 2.5
    assert edit["step"] == 1 and kp(served) == 0.4
    editor.step(1)  # the run goes on in the brighter world
    run = served.run
    assert run.simulation.world.scene.ambient_lx == 2.5 and len(run.rows) == 2


def test_a_run_at_rest_shows_what_edits_make_of_the_next_step(served, editor):
    run = served.run
    before, made = run.snapshots[0], len(run.rows)
    wall = 'objects=[{kind = "box", name = "wall", size_m = [0.5, 2, 1], track = [{position_m = [14, 3, 0]}]}]'
    editor.set(wall, 'functions.wide={kind = "primitive", x_m = 15, width_m = 6}')
    seen, _ = editor.of("step", step=0)
    meshes = [
        head["id"] for message, _ in editor.got if message["type"] == "meshes" for head in message["meshes"] if head["object"] == "wall"
    ]
    assert [each["T_world_body"][3] for each in seen["bodies"] if each["mesh"] in meshes] == [14.0]
    shown = run.snapshots[0].lights
    assert any(not u.equal(old) for u, old in zip(shown, before.lights, strict=True)) and len(run.rows) == made
    editor.step(1)
    assert all(u.equal(now) for u, now in zip(shown, run.snapshots[1].lights, strict=True))
    assert all(u.equal(old) for u, old in zip(run.snapshots[0].lights, before.lights, strict=True))  # the step as it was


def test_edits_are_taken_back_and_made_again(served, editor, monkeypatch):
    monkeypatch.setattr("luxloop.loop.studio.session.TOGETHER_S", 0.0)
    first = kp(served)
    for value in (0.5, 0.6):
        editor.set(f"{KP}={value}")
    for way, value in (("undo", 0.5), ("undo", first), ("redo", 0.5)):
        editor.say(way)
        editor.of("edit", overrides=[f"{KP}={value}"])
    assert kp(served) == 0.5
    editor.set(f"{KP}=0.7")
    editor.say("redo")
    assert "nothing to redo" in editor.of("error", about="redo")[0]["text"]


def test_edits_of_a_drag_are_one(served, editor, monkeypatch):
    monkeypatch.setattr("luxloop.loop.studio.session.TOGETHER_S", 60.0)  # a busy machine takes longer than TOGETHER_S for some edits
    assert TOGETHER_S < 60
    before = served.scenario
    for x_m in (17.1, 17.2, 17.3):
        editor.set(f"functions.symbol.x_m={x_m}")
    editor.say("undo")
    editor.of("edit")
    assert served.scenario == before


def test_what_is_saved_is_the_scenario_as_it_is_now(served, editor, tmp_path):
    editor.set(f"{KP}=0.45", "light.ambient_lx=0.4")
    editor.say("save")
    saved, _ = editor.of("saved")
    (tmp_path / saved["name"]).write_text(saved["text"])
    assert saved["name"] == "snowflake.toml"
    assert load(str(tmp_path / saved["name"])) == served.scenario


def test_a_recording_has_all_steps_and_edits_and_is_repeated(editor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    editor.step(1)
    editor.set(f"{KP}=0.33")
    editor.say("record", folder="mine")
    editor.of("status", recording="mine")
    editor.step(2, 3)
    another = ("light.ambient_lx=0.5", "functions.second={kind='symbol',image='snowflake',x_m=20.0,controller={name='thesis_pid'}}")
    editor.set(*another)
    editor.step(4)
    editor.set("functions.second={}", "steps=6")
    editor.step(5)
    editor.of("status", recording=None)  # at the end of the run
    folder = tmp_path / "runs/mine"
    read = recording(folder)
    assert read.manifest.status == "complete" and read.table.num_rows == 6
    assert cv2.imread(str(folder / REPORT)).std() > 10  # something is drawn
    checks = json.loads((folder / SUMMARY).read_text())["checks"]
    assert checks.keys() == {"lies_on_target"}  # the other one compares with a light that did not run beside
    edits = [(2, (f"{KP}=0.33",)), (4, another), (5, ("functions.second={}", "steps=6"))]
    assert [(each.step, each.overrides) for each in read.edits] == edits
    assert replay(folder).agrees
    for _ in range(2):
        editor.say("undo")
        editor.of("edit")
    editor.say("record", folder="../mine")
    assert "folder" in editor.of("error")[0]["text"]


def test_the_file_is_an_editor_as_well(served, editor, file):
    editor.set("light.ambient_lx=0.7")
    text = file.read_text()
    file.write_text(text.replace("description = ", "x = ", 1))
    assert "unknown key" in editor.until(lambda head: head["type"] == "status" and head["failed"] is not None)[0]["failed"]
    assert "[light]" not in text
    file.write_text(text + "\n[light]\nstreet_lamps = [{position_m = [20.0, 5.0, 6.0], intensity_cd = 900.0}]\n")
    told, _ = editor.of("edit")
    assert "street_lamps" in told["overrides"][0]
    light = served.scenario.light
    assert light.ambient_lx == 0.7 and light.street_lamps[0].intensity_cd == 900
    file.write_text(text)
    editor.of("edit")
    assert not served.scenario.light.street_lamps


def test_a_step_that_is_over_takes_little_memory_beside_its_light(file, monkeypatch):
    monkeypatch.setattr("luxloop.loop.recording.recorder.FOLDED", 5)
    (run,) = start([(Source(str(file)), None)], (), frozenset(), print, anew=True)
    while not run.over:
        if len(run.snapshots) == 11:
            tracemalloc.start()
        run.step(frozenset({"marks"}))
    kept = [tracemalloc.Filter(True, f"*/loop/{each}") for each in ("recording/record*.py", "studio/*.py")]
    taken = tracemalloc.take_snapshot().filter_traces(kept).statistics("filename")
    tracemalloc.stop()
    assert sum(each.size for each in taken) / 19 < 3000, "where rows and poses as Python's values take 10 kB a step"
    assert run.snapshots[3].head["step"] == 3 and run.tally.table()["step"].to_pylist() == list(range(30))


def test_a_comparison_begins_with_all_edits(served, editor):
    def holds(ambient_lx: float, *gains: float) -> bool:
        runs = [run.simulation.scenario for run in served.studio.session.state.runs]
        return [(each.light.ambient_lx, each.symbol.controller.position.kp) for each in runs] == [(ambient_lx, gain) for gain in gains]

    editor.set("light.ambient_lx=0.9")
    first = kp(served)
    editor.say("compare", overrides=[f"{KP}=0.8"])
    assert len(editor.of("scenario")[0]["runs"]) == 2
    assert first != 0.8 and holds(0.9, first, 0.8)
    editor.say("set", overrides=["light.ambient_lx=0.8", f"{KP}=0.7"])
    assert editor.of("edit", run=1)[0]["overrides"] == ["light.ambient_lx=0.8", f"{KP}=0.7", f"{KP}=0.8"]  # what makes its scenario
    assert holds(0.8, 0.7, 0.8)
    editor.say("undo")
    editor.of("edit", run=1)
    editor.say("compare")
    assert len(editor.of("scenario")[0]["runs"]) == 1
    assert holds(0.9, first)


def test_edits_that_set_the_same_values_anew_before_a_step_are_kept_once(served, editor):
    for override in (f"{KP}=0.3", f"{KP}=0.35", "light.ambient_lx=0.6", f"{KP}=0.4"):
        editor.set(override)
    assert [each.overrides for each in served.run.tally.edits] == [(f"{KP}=0.35",), ("light.ambient_lx=0.6",), (f"{KP}=0.4",)]
