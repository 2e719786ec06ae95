"""Edits while a run goes on are part of its recording, and repeated with it."""

import json
from pathlib import Path

import pytest

from luxloop import LuxloopError, Simulation
from luxloop.loop.recording.manifest import EDITS
from luxloop.loop.recording.recorder import Recorder
from luxloop.loop.recording.replay import apply_edit, load, replay, rerun
from luxloop.loop.scenario.edits import Edit, with_overrides
from luxloop.loop.scenario.model import load as scenario
from tests.lamps import SMALL_LAMP

SMALL = (
    f"headlight.model={SMALL_LAMP}",
    "renderer=raycast",
    "camera.width_px=320",
    "camera.height_px=180",
    "camera.oversampling=1",
    "judge_every=0",
    "steps=9",
)
EDITS_MADE = {
    2: ("functions.symbol.controller.position.kp=0.3",),
    4: ("light.ambient_lx=0.6", 'functions.light={kind = "marker", categories = ["pedestrian"]}'),
    6: ("functions.light={}",),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of snowflake with an edit of a gain, of the world and of the functions."""
    directory = tmp_path_factory.mktemp("edited")
    simulation = Simulation.prepare(scenario("snowflake", SMALL))
    state = simulation.start()
    with Recorder(directory, simulation) as recorder:
        for step in range(9):
            if overrides := EDITS_MADE.get(step):
                simulation, state = apply_edit(simulation, state, with_overrides(simulation.scenario, overrides))
                recorder.edit(simulation, Edit(step=step, overrides=overrides))
            state, result = simulation.step(state)
            result = simulation.evaluate(result)
            recorder.add(result)
    return directory


def test_a_recording_with_edits_is_repeated_with_them_each_step_by_the_simulation_that_made_it(recorded):
    recording = load(recorded)
    assert [(each.step, each.overrides) for each in recording.edits] == list(EDITS_MADE.items())
    assert recording.scenario == scenario("snowflake", SMALL)
    assert replay(recorded).agrees
    there = ["light" in made_by.scenario.functions for made_by, _ in rerun(recording, Simulation.prepare(recording.scenario))]
    assert there == [False] * 4 + [True] * 2 + [False] * 3


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[", "edits.json: damaged, not the edits of a run"),
        (json.dumps([{"step": -1, "overrides": []}]), "edits.json: damaged, not the edits of a run"),
        (json.dumps([{"step": 1, "overrides": ["seed=3"]}]), "cannot go on with these values"),
        (json.dumps([{"step": 1, "overrides": ["camera.bitz=3"]}]), "did you mean 'bits'"),
        (json.dumps([{"step": 1, "overrides": ["functions.own.kind=os:system"]}]), "--allow-code"),
    ],
)
def test_damaged_and_foreign_edits_are_refused(recorded, tmp_path, text, told):
    for each in recorded.iterdir():
        (tmp_path / each.name).write_bytes(each.read_bytes())
    (tmp_path / EDITS).write_text(text)
    with pytest.raises(LuxloopError, match=told):
        replay(tmp_path)
