"""Recordings in the studio: listed, opened at once, and repeated with their edits."""

import json
import shutil
from collections.abc import Iterator

import numpy as np
import pytest

import luxloop
from luxloop.loop.recording.manifest import EDITS, TRAJECTORY
from luxloop.loop.studio.sources import Source
from luxloop.world.arrays import read_parquet
from tests.loop.studio.clients import Watcher, watching
from tests.loop.studio.conftest import SMALL, Served, serving

KP = "functions.symbol.controller.position.kp=0.31"


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, luxloop.RunResult]]:
    """A studio that was started with a scenario that is not there, in a folder with a recording of frames in `runs`."""
    folder = tmp_path_factory.mktemp("work")
    recorded = luxloop.run("snowflake", folder / "runs/one", overrides=SMALL, frames=True, video=False, report=False, device="cpu")
    (folder / "runs/none").mkdir()
    shutil.copytree(folder / "runs/one", folder / "elsewhere")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for served in serving(Source("nowhere"), folder):
            yield served, recorded


@pytest.fixture
def editor(studio: tuple[Served, luxloop.RunResult]) -> Iterator[Watcher]:
    served, _ = studio
    with watching(served.port, served.tokens.edit) as watcher:
        watcher.say("pen")  # which the client of the test before may still hold
        watcher.of("choices")
        yield watcher


def test_a_studio_without_a_scenario_tells_what_there_is_to_choose_from(studio):
    served, _ = studio
    with watching(served.port, served.tokens.watch) as watcher:
        found, _ = watcher.of("choices")
        assert {"snowflake", "gfhb"} <= {each["name"] for each in found["scenarios"]} and found["controllers"] and found["rules"]
        (recording,) = found["recordings"]
        assert recording["name"] == "runs/one" and recording["description"].startswith("snowflake, 6 steps, ")
        assert "nowhere" in watcher.until(lambda head: head["type"] == "status" and head["failed"])[0]["failed"]


def test_rows_and_frames_of_a_recording_are_there_before_it_is_run_again(studio, editor):
    served, recorded = studio
    editor.say("open", recording="runs/one")
    scenario, _ = editor.of("scenario")
    rows, arrays = editor.of("rows")
    assert rows["first"] == 0 and len(arrays["rows"]) == scenario["steps"] == 6
    editor.say("pause")
    names = [each["name"] for each in scenario["runs"][0]["columns"]]
    iou = read_parquet(recorded.folder / TRAJECTORY)["functions.symbol.iou"].to_numpy()
    assert np.array_equal(arrays["rows"][:, names.index("functions.symbol.iou")], iou.astype(np.float32), equal_nan=True)
    run = served.run
    assert run.playback is not None
    for step in (5, 2):
        known, done = run.playback.snapshot(step, run.snapshots[-1]), len(run.snapshots)
        assert done > step or known.pictures["camera.on"].shape == (180, 320)
    editor.say("scrub", run=0, step=5)
    seen, arrays = editor.of("step", scrub=True, step=5)
    assert arrays["camera.on"].shape == (180, 320) and seen["time_s"] == pytest.approx(5 / scenario["rate_hz"])
    editor.say("play")
    editor.of("status", playing=False)
    assert all(
        np.array_equal(run.playback.snapshot(k, run.snapshots[0]).pictures["camera.on"], each.pictures["camera.on"])
        for k, each in enumerate(run.snapshots)
        if "camera.on" in each.pictures
    )


def test_an_edit_ends_the_repetition(studio, editor):
    served, _ = studio
    editor.say("open", recording="runs/one")
    editor.of("scenario")
    editor.say("pause")
    editor.of("status", playing=False)
    editor.say("record", folder="one")
    assert "is what is shown" in editor.of("error", about="record")[0]["text"]
    done = len(served.run.snapshots)
    editor.say("set", overrides=[KP])
    editor.of("edit", step=done)
    _, arrays = editor.of("rows", first=0)
    assert len(arrays["rows"]) == done
    editor.say("reset")  # the edited run, not the recording
    editor.of("scenario")
    run = served.run
    assert run.playback is None and run.simulation.symbol.params.position.kp == float(KP.partition("=")[2])  # type: ignore[union-attr]


def test_edits_of_a_recording_are_repeated(studio, editor):
    served, recorded = studio
    again = recorded.folder.parent / "edited"
    shutil.copytree(recorded.folder, again)
    (again / EDITS).write_text(json.dumps([{"step": 3, "overrides": [KP]}]))
    editor.say("open", recording="runs/one")  # after which the new one is known
    editor.until(lambda head: head["type"] == "choices" and len(head["recordings"]) == 2)
    editor.say("open", recording="runs/edited")
    edit, _ = editor.of("edit")
    assert edit["step"] == 3 and edit["overrides"] == [KP]
    assert served.run.simulation.symbol.params.position.kp == 0.31


def test_other_folders_are_not_opened(studio, editor):
    number = studio[0].studio.session.state.number
    for folder in ("elsewhere", "runs/none", "runs/../elsewhere", "/tmp", ""):
        editor.say("open", recording=folder)
        editor.of("error", about="open")
    assert studio[0].studio.session.state.number == number
