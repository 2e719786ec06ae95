"""Symbols that lie on the road itself: drawn for a place, and found where the flat road's light is nowhere or far away."""

import math

import pytest
import torch

from luxloop import load
from luxloop.controllers.symbol.sensing.projection import CELLS
from luxloop.loop.simulation.result import StepResult
from luxloop.perception.birdseye import birds_eye, cells, region_around
from luxloop.perception.camera import CameraParams, camera_view
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of
from tests.refusal import refusal

SMALL = [
    f"headlight.model={SMALL_LAMP}",
    "camera={width_px=640, height_px=480}",
    "functions.symbol.start={x_m=17.0, y_m=0.0, roll_deg=0.0, pitch_deg=0.0}",
    "functions.symbol.controller={name='luxloop'}",
]


def ends(road: str, steps: int, *more: str) -> StepResult:
    """The last step of a run with the snowflake on the road itself."""
    changes = [*SMALL, "functions.symbol={image='snowflake', target='place'}", f"road={{{road}}}", *more]
    *_, last = simulation_of(load("flat", changes, steps=steps)).evaluations()
    return last


@pytest.mark.parametrize("percent", [-2, 3])
def test_luxloop_lays_the_symbol_on_the_road(percent):
    last = ends(f"kind='grade', grade_percent={percent}, crossfall_percent=0, start_x_m=3", 6)
    assert float(last.symbol.metrics.iou) > 0.8  # a ray a texel gives 0.86 and 0.94
    assert last.symbol.metrics.centroid_percent.abs().max() < 5
    assert last.symbol.aim.isnan().all()


def test_feedforward_for_the_true_road_lays_it_there_at_once():
    road = "kind='grade', grade_percent=4, crossfall_percent=2, start_x_m=3"
    last = ends(road, 1, f"functions.symbol.controller={{name='feedforward', road={{{road}}}}}")
    assert float(last.symbol.metrics.iou) > 0.9  # a ray a texel gives 0.93
    assert last.symbol.metrics.shear.abs() < 0.01  # the evaluator's cells lie on the road, which falls to the side


def test_a_symbol_that_is_nowhere_in_the_image_is_found_on_a_road_that_falls():
    # On this crest no light of a symbol for the flat road arrives where the camera sees it.
    last = ends("kind='grade', grade_percent=-12, crossfall_percent=0, start_x_m=3, curve_m=60", 5)
    assert float(last.symbol.metrics.iou) > 0.8  # a ray a texel gives 0.88


@pytest.mark.slow
def test_a_road_that_was_believed_too_high_is_lowered_until_light_is_seen():
    # The flat road's symbol lies on the face of the step, which looks like a steep slope.
    last = ends("kind='step', x_m=12, height_m=0.3, ramp_m=0.5", 5)
    assert float(last.symbol.metrics.iou) > 0.8  # a ray a texel gives 0.90


@pytest.mark.slow
def test_the_nearest_place_that_is_lit_is_recorded():
    last = ends("kind='grade', grade_percent=-4, crossfall_percent=0, start_x_m=3", 5)
    assert 25 < float(last.symbol.aim[0]) < 33 and float(last.symbol.aim[1]) == pytest.approx(0.0, abs=0.1)
    assert last.symbol.measurement.code == 0 and last.symbol.cut.sum() < 0.02


@pytest.mark.parametrize("controller", ["thesis_pid", "gauss_newton", "model_reference"])
def test_controllers_that_hold_an_appearance_refuse_a_place(controller):
    with refusal(rf'functions.symbol: target: {controller} .* set controller.name = "luxloop"'):
        load("flat", ["functions.symbol.target='place'", f"functions.symbol.controller={{name='{controller}'}}"])


def test_the_evaluators_cells_lie_on_the_road_and_hidden_ones_nowhere():
    view, region = camera_view(CameraParams()), region_around(17.0, 0.0, 4.0, 2.0)
    flat = cells(region)
    assert birds_eye(region, view, flat).map_u.equal(birds_eye(region, view).map_u), "on a flat road nothing is hidden"
    wall = flat.clone()
    wall[2] = torch.where((flat[0] > 15.0) & (flat[0] < 15.2), 0.5, 0.0)
    seen = birds_eye(region, view, wall)
    eye_z, eye_x = float(view.origin[2]), float(view.origin[0])
    shadow_m = 15.2 + (15.2 - eye_x) * 0.5 / (eye_z - 0.5)  # where the line of sight over its edge comes down
    x, column = flat[0, :, 0], seen.map_u[:, CELLS[1] // 2]
    hidden = x[column < 0]
    assert float(hidden.min()) == pytest.approx(15.2, abs=0.05) and float(hidden.max()) == pytest.approx(shadow_m, abs=0.1)
    assert math.isclose(len(hidden) * region.cell_m, shadow_m - 15.2, abs_tol=0.15)
