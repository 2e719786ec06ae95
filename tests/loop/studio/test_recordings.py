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
from tests.loop.studio.clients import watching
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


def test_a_studio_without_a_scenario_tells_what_there_is_to_choose_from(studio: tuple[Served, luxloop.RunResult]) -> None:
    served, _ = studio
    with watching(served.port, served.tokens.watch) as watcher:
        found, _ = watcher.of("choices")
        assert {"snowflake", "gfhb"} <= {each["name"] for each in found["scenarios"]} and found["controllers"] and found["rules"]
        (recording,) = found["recordings"]
        assert recording["name"] == "runs/one" and recording["description"].startswith("snowflake, 6 steps, ")
        assert "nowhere" in watcher.until(lambda head: head["type"] == "status" and head["failed"])[0]["failed"]


def test_rows_and_frames_of_a_recording_are_there_before_it_is_run_again(studio: tuple[Served, luxloop.RunResult]) -> None:
    served, recorded = studio
    with watching(served.port, served.tokens.edit) as watcher:
        watcher.of("choices")
        watcher.say(type="pen")  # which the client of the test before may still hold
        watcher.say(type="open", recording="runs/one")
        scenario, _ = watcher.of("scenario")
        rows, arrays = watcher.of("rows")
        assert rows["first"] == 0 and len(arrays["rows"]) == scenario["steps"] == 6
        watcher.say(type="pause")
        names = [each["name"] for each in scenario["runs"][0]["columns"]]
        iou = read_parquet(recorded.folder / TRAJECTORY)["functions.symbol.iou"].to_numpy()
        assert np.array_equal(arrays["rows"][:, names.index("functions.symbol.iou")], iou.astype(np.float32), equal_nan=True)
        (run,) = served.studio.session.state.runs
        assert run.playback is not None
        for step in (5, 2):
            known, done = run.playback.snapshot(step, run.snapshots[-1]), len(run.snapshots)
            assert done > step or known.pictures["camera.on"].shape == (180, 320)
        watcher.say(type="scrub", run=0, step=5)
        seen, arrays = watcher.of("step", scrub=True, step=5)
        assert arrays["camera.on"].shape == (180, 320) and seen["time_s"] == pytest.approx(5 / scenario["rate_hz"])
        watcher.say(type="play")
        watcher.of("status", playing=False)
        assert all(
            np.array_equal(run.playback.snapshot(k, run.snapshots[0]).pictures["camera.on"], each.pictures["camera.on"])
            for k, each in enumerate(run.snapshots)
            if "camera.on" in each.pictures
        )


def test_an_edit_ends_the_repetition(studio: tuple[Served, luxloop.RunResult]) -> None:
    served, _ = studio
    with watching(served.port, served.tokens.edit) as watcher:
        watcher.of("choices")
        watcher.say(type="pen")  # which the client of the test before may still hold
        watcher.say(type="open", recording="runs/one")
        watcher.of("scenario")
        watcher.say(type="pause")
        watcher.of("status", playing=False)
        watcher.say(type="record", folder="one")
        assert "is what is shown" in watcher.of("error", about="record")[0]["text"]
        done = len(served.studio.session.state.runs[0].snapshots)
        watcher.say(type="set", overrides=[KP])
        watcher.of("edit", step=done)
        _, arrays = watcher.of("rows", first=0)
        assert len(arrays["rows"]) == done
        watcher.say(type="reset")  # the edited run, not the recording
        watcher.of("scenario")
        (run,) = served.studio.session.state.runs
        assert run.playback is None and run.simulation.symbol.params.position.kp == float(KP.partition("=")[2])  # type: ignore[union-attr]


def test_edits_of_a_recording_are_repeated(studio: tuple[Served, luxloop.RunResult]) -> None:
    served, recorded = studio
    again = recorded.folder.parent / "edited"
    shutil.copytree(recorded.folder, again)
    (again / EDITS).write_text(json.dumps([{"step": 3, "overrides": [KP]}]))
    with watching(served.port, served.tokens.edit) as watcher:
        watcher.of("choices")
        watcher.say(type="pen")  # which the client of the test before may still hold
        watcher.say(type="open", recording="runs/one")  # after which the new one is known
        watcher.until(lambda head: head["type"] == "choices" and len(head["recordings"]) == 2)
        watcher.say(type="open", recording="runs/edited")
        edit, _ = watcher.of("edit")
        assert edit["step"] == 3 and edit["overrides"] == [KP]
        assert served.studio.session.state.runs[0].simulation.symbol.params.position.kp == 0.31


@pytest.mark.parametrize("folder", ["elsewhere", "runs/none", "runs/../elsewhere", "/tmp", ""])
def test_other_folders_are_not_opened(studio: tuple[Served, luxloop.RunResult], folder: str) -> None:
    served, _ = studio
    with watching(served.port, served.tokens.edit) as watcher:
        watcher.of("choices")
        watcher.say(type="pen")  # which the client of the test before may still hold
        number = served.studio.session.state.number
        watcher.say(type="open", recording=folder)
        watcher.of("error", about="open")
        assert served.studio.session.state.number == number
