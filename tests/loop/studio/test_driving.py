"""Somebody drives in the studio: the car goes where it is steered, and the drive is recorded and repeated."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from luxloop import Simulation, load
from luxloop.loop.recording.replay import load as recording
from luxloop.loop.recording.replay import replay, rerun
from luxloop.loop.scenario.text import scenario_text
from luxloop.loop.studio.sources import Source
from tests.loop.studio.clients import Watcher, watching
from tests.loop.studio.conftest import SMALL, Served, serving

PLAIN = (
    *SMALL,
    "headlight.model=hd84",
    "camera={width_px=160, height_px=90, oversampling=1}",
    "rate_hz=30.0",
    "functions={}",
    "checks={}",
    "objects=[]",
    "lighting.base.beam=low",
    "road={kind='iso8608', roughness_class='C'}",
)
PERIOD_S = 1 / 30


@pytest.fixture(scope="module")
def served(page_folder: Path) -> Iterator[Served]:
    yield from serving(Source("gfhb", (*PLAIN, "vehicle.course=[{speed_m_s=10.0}]", "steps=5")), page_folder)


@pytest.fixture(autouse=True)
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing that of a recording takes longer than the drive."""
    monkeypatch.setattr("luxloop.loop.report.page.write_report", lambda *_: None)


@pytest.fixture
def driver(editor: Watcher) -> Watcher:
    editor.say("set", overrides=["vehicle.course=[{speed_m_s=10.0}]", "vehicle.roams=false", "steps=5", "seed=1"])
    editor.say("reset")
    editor.of("scenario", steps=5)
    return editor


def test_a_drive_goes_on_beyond_the_steps_is_recorded_and_repeated_bit_for_bit(served, driver, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    driver.say("record", folder="drive")
    driver.of("status", recording="drive")
    driver.say("drive", throttle=1.0, steering=0.5)
    assert driver.of("edit")[0]["model"]["vehicle"]["roams"]
    driver.step(*range(1, 13))
    driver.say("drive", throttle=-1.0, steering=-1.0)
    driver.step(*range(13, 21))
    run = served.run
    assert run.simulation.world.motion.at(13 * PERIOD_S).speed_m_s == pytest.approx(11.2, abs=1e-2)
    assert run.simulation.world.motion.at(21 * PERIOD_S).speed_m_s == pytest.approx(
        11.2 - 8 * 8 * PERIOD_S, abs=1e-2
    )  # linear between its moments
    assert not [head for head, _ in driver.got if head["type"] == "edit" and any("course[" in each for each in head["overrides"])]
    driver.say("drive", throttle=None, steering=None)
    told = driver.of("edit")[0]
    assert told["model"]["vehicle"]["course"][-1]["curvature_1_m"] == 0 and told["model"]["steps"] == 22
    driver.step(21)
    driver.say("record", folder=None)
    driver.of("status", recording=None)
    read = recording(tmp_path / "runs" / "drive")
    assert len(read.edits) == 22 and sum(each.driven for each in read.edits) == 20
    assert replay(tmp_path / "runs" / "drive").agrees
    *_, (again, _) = rerun(read, Simulation.prepare(read.scenario))
    assert again.scenario == run.simulation.scenario
    assert np.array_equal(again.world.motion.states, run.simulation.world.motion.states)


def test_a_drive_is_the_same_as_its_scenario_run_anew(served, driver, tmp_path):
    driver.say("drive", throttle=1.0, steering=1.0)
    driver.step(1, 2, 3)
    driver.say("drive", throttle=None, steering=None)
    driver.of("edit", step=4)
    (tmp_path / "driven.toml").write_text(scenario_text(served.scenario))
    assert load(str(tmp_path / "driven.toml")) == served.scenario


def test_edits_while_somebody_drives_are_taken_back_and_the_drive_stays(served, driver):
    driver.say("drive", throttle=1.0, steering=0.0)
    driver.step(*range(1, 4))
    driver.set("lighting.base.beam=high")
    driver.step(*range(4, 7))
    course = served.scenario.vehicle.course
    driver.say("undo")
    driver.of("edit", overrides=['lighting.base.beam="low"'])
    assert served.scenario.vehicle.course == course


def test_who_goes_away_lets_go(served, driver):
    with watching(served.port, served.tokens.edit) as other:
        other.of("scenario")
        other.say("pen")
        other.say("drive", throttle=1.0, steering=1.0)
        other.of("edit")
        other.step(*range(1, 4))
    driver.of("edit", step=4)
    assert served.scenario.vehicle.course[-1].curvature_1_m == 0
    assert served.studio.session._steering is None


def test_traffic_stays_as_it_was_made(served, driver):
    driver.set("traffic={seed=3}", "steps=60")
    before = served.scenario.all_objects
    assert before
    driver.say("drive", throttle=1.0, steering=1.0)
    driver.of("edit", step=1)
    driver.step(*range(1, 3))
    assert served.scenario.all_objects == before and served.scenario.traffic.drive.lasts_s == 2
    driver.say("drive", throttle=None, steering=None)
    assert driver.of("edit")[0]["model"]["steps"] == 60


def test_who_stands_cannot_drive_and_watchers_neither(served, driver):
    driver.say("set", overrides=["vehicle={}"])
    driver.of("scenario")
    with watching(served.port, served.tokens.watch) as watcher:
        for each, words in ((driver, "the vehicle stands"), (watcher, "watch")):
            each.say("drive", throttle=1.0, steering=0.0)
            assert words in each.of("error", about="drive")[0]["text"]


def test_the_indicator_acts_at_the_next_step_and_is_repeated(driver, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    driver.set('lighting.base.beam="off"', 'functions.turning={kind="primitive", indicated="left"}')
    driver.reset()
    driver.say("record", folder="indicated")
    driver.of("status", recording="indicated")
    driver.step(1)
    driver.set('lighting.indicator="left"')
    driver.step(2, 3)
    driver.say("record", folder=None)
    driver.of("status", recording=None)
    folder = tmp_path / "runs" / "indicated"
    flux = pq.read_table(folder / "trajectory.parquet")
    lit = [any(flux[name][k].as_py() > 0 for name in flux.column_names if name.endswith("flux_lm")) for k in range(4)]
    assert lit == [False, False, True, True]
    assert replay(folder).agrees
    driver.set("functions.turning={}", 'lighting.base.beam="low"', 'lighting.indicator="off"')
