"""A recording through which functions come and go ends with a summary and a report, and is repeated."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from luxloop.loop.recording.manifest import REPORT
from luxloop.loop.recording.replay import load as recording
from luxloop.loop.recording.replay import replay
from luxloop.loop.studio.sources import Source
from tests.loop.studio.conftest import SMALL, Served, serving

HELD = "{kind='symbol',image='snowflake',x_m=17.0,yaw_deg=20.0}"
EDITS = (
    ("lighting.base.beam='low'", "functions.wall={kind='zone',centre_m=[17.0,3.0,1.0],size_m=[0.0,1.6,1.6],luminance_cd_m2=0.9}"),
    (f"functions.held={HELD}", "functions.marks={kind='material',lights=[{materials=['asphalt'],luminance_cd_m2=0.1}]}"),
    ("functions.wall={}", "lighting.base.beam='off'"),
    ("functions.held={}", "functions.marks={}", "functions.guard_traffic={}"),
    ("functions.wall={kind='zone',centre_m=[17.0,3.0,1.0],size_m=[0.0,1.6,1.6],luminance_cd_m2=0.9}", "lighting.base.beam='high'"),
)


@pytest.fixture(scope="module")
def served(page_folder: Path) -> Iterator[Served]:
    yield from serving(Source("gfhb", SMALL), page_folder)


@pytest.mark.slow
def test_functions_come_and_go_in_a_recording(editor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    editor.of("step", step=0)
    editor.say("record", folder="mine")
    editor.of("status", recording="mine")
    for step, overrides in enumerate(EDITS, 1):
        editor.say("set", overrides=list(overrides))
        editor.of("edit")
        editor.step(step)
    editor.of("status", recording=None)  # at the end of the run
    editor.say("summary", run=0)
    assert editor.of("summary")[0]["summary"]["steps"] == 6
    read = recording(tmp_path / "runs/mine")
    assert read.manifest.status == "complete" and read.table.num_rows == 6 and len(read.edits) == len(EDITS)
    assert cv2.imread(str(tmp_path / "runs/mine" / REPORT)).std() > 10  # something is drawn
    assert replay(tmp_path / "runs/mine").agrees


def test_a_check_of_what_is_not_recorded_is_refused(editor, served):
    before = served.scenario
    editor.say("set", overrides=["checks.mine={metric='flux_lmm',at_least=0.5}"])
    assert "flux_lmm" in editor.of("error")[0]["text"]
    assert served.scenario == before
