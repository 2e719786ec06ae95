"""Structured light: the road's heights from Gray codes, frames that are late or lost, and a road file that is resolved."""

import pytest

from luxloop import Simulation, load
from luxloop.controllers.symbol.heights.feedforward import MeasuringFeedforward
from luxloop.loop.scenario.overrides import resolve_paths
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of
from tests.refusal import refusal

SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=640", "camera.height_px=360", "camera.oversampling=2"]
LIFTED = 'road={kind="curb", y_m=-8.0, ramp_m=0.03, height_m=0.03}'  # a plane 3 cm too high
SURVEY = "functions.symbol.controller={name='feedforward', survey=true}"


def simulation(*changes: str) -> Simulation:
    return simulation_of(load("flat", [*SMALL, SURVEY, *changes]))


def test_a_survey_finds_a_lifted_plane_and_draws_for_it():
    sim = simulation(LIFTED, "steps=20")
    state = sim.start()
    for _ in range(20):
        state, result = sim.step(state)
    metrics = sim.evaluate(result).symbol.metrics
    assert isinstance(sim.symbol.controller, MeasuringFeedforward)
    heights = sim.symbol.controller.relief(state.symbols["symbol"].controller.seen).heights
    assert heights.mean() == pytest.approx(0.03, abs=0.002)  # the camera has half a row of the lamp's in a row of its own
    # the evaluator's limit for a right symbol: what a camera of 20 cm a row leaves of the edges
    assert metrics.centroid_percent.abs().max() < 2.0 and metrics.iou > 0.85


def test_the_road_that_is_believed_in_is_found_as_the_true_one_is(tmp_path):
    road = {"kind": "opencrg", "file": "./mine.crg"}
    resolve_paths({"functions": {"symbol": {"controller": {"name": "feedforward", "road": road}}}}, tmp_path)
    assert road["file"] == str(tmp_path / "mine.crg")
    with refusal("no data file 'belgian_blok'"):
        simulation("functions.symbol.controller={name='feedforward', road={kind='opencrg', file='belgian_blok'}}")
