"""The loop as a whole, on a road whose shape the controller is right about."""

import pytest
import torch

from luxloop import Scenario, load, prepare
from luxloop.controllers.functions.base_beams import BaseBeamParams
from luxloop.controllers.symbol.sensing.projector import StartParams
from luxloop.perception.camera import luminance_of
from tests.loop.conftest import simulation_of
from tests.refusal import refusal


def test_the_controller_knows_that_the_road_is_wet(small_scenario):
    surface = small_scenario.surface.model_copy(update={"wet": 1.0})
    functions = {"symbol": small_scenario.symbol.model_copy(update={"start": StartParams()})}
    wet = small_scenario.model_copy(update={"surface": surface, "functions": functions, "steps": 6})
    metrics = [result.symbol.metrics for result in simulation_of(wet).evaluations()]
    # At the target light and model agree; noise moves the symbol by a few centimetres then. A model of a dry road has 0.6 throughout.
    assert metrics[0].iou > 0.98
    assert min(float(each.iou) for each in metrics) > 0.85 and metrics[-1].iou > 0.9


def in_a_beam(scenario: Scenario, beam: str, steps: int, **symbol: object) -> Scenario:
    lighting = scenario.lighting.model_copy(update={"base": BaseBeamParams(beam=beam)})
    headlight = scenario.headlight.model_copy(update={"model": "idealised-332x1024"})
    functions = {"symbol": scenario.symbol.model_copy(update=symbol)}
    return scenario.model_copy(update={"headlight": headlight, "lighting": lighting, "functions": functions, "steps": steps})


@pytest.mark.parametrize("symbol", [{}, {"quantity": "u_rel", "value": 5.0}], ids=["u_abs", "u_rel"])
def test_a_symbol_settles_in_a_burning_beam(small_scenario, symbol):
    simulation = prepare(in_a_beam(small_scenario, "low", 30, **symbol))
    results = list(simulation.evaluations())
    # Off frames show the beam, at least three times the ambient light about the symbol; the median leaves no noise worth a tolerance.
    shining, dark = simulation.world.luminance(0.0, results[0].exposures[-1].lights)
    off, lit = torch.stack([luminance_of(each.frames[1], simulation.scenario.camera) for each in results]), shining > 3 * dark
    seen = off.mean(0)[lit]
    assert len(seen) > 1000 and seen.median() == pytest.approx(float(shining[lit].median()), rel=0.02)
    # It starts half its size away. In the end noise moves it by 2 %, an eighth of a pixel of this coarse camera along the road.
    last = torch.stack([each.symbol.metrics.centroid_percent for each in results[-8:]])
    assert results[0].symbol.metrics.centroid_percent.abs().min() > 50 and last.abs().max() < 2
    assert min(float(each.symbol.metrics.iou) for each in results[-8:]) > 0.8


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["lighting.base.beam=full"], "nowhere brighter than the full beam; raise value, or name a dimmer beam"),
        (["functions.symbol.quantity=u_rel"], 'u_rel is a multiple of the base beam.*lighting.base.beam = "low"'),
        (["lighting.base.beam=lwo"], "lighting.base.beam: 'lwo' is not possible; did you mean 'low'"),
    ],
)
def test_a_beam_that_takes_no_symbol_is_refused(changes, words):
    with refusal(words):
        prepare(load("flat", ["camera.width_px=320", "camera.height_px=180", "renderer=raycast", *changes]))
