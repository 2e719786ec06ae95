"""Gauss-Newton, model reference and feed-forward in a small closed loop."""

from itertools import islice

import pytest
import torch

from luxloop import load
from luxloop.controllers.symbol.heights.feedforward import height_map_of
from luxloop.perception.birdseye import Region
from luxloop.world.roads.shapes import Curb, Flat
from tests.loop.conftest import simulation_of

SMALL = ["camera.width_px=640", "camera.height_px=360", "camera.oversampling=2"]
LIFTED = '{kind="curb", y_m=-8.0, ramp_m=0.03, height_m=0.03}'  # a plane 3 cm too high, from well before the symbol on
GIVEN = f"{{name='feedforward', road={LIFTED}}}"


def run(controller: str, steps: int, *more: str) -> tuple[torch.Tensor, list[float]]:
    """The evaluator's centroid errors `[steps, 2]` in % and IoU on a plane 3 cm too high."""
    simulation = simulation_of(load("flat", [*SMALL, f"road={LIFTED}", f"functions.symbol.controller={controller}", *more]))
    metrics = [result.symbol.metrics for result in islice(simulation.evaluations(), steps)]
    return torch.stack([each.centroid_percent for each in metrics]), [float(each.iou) for each in metrics]


@pytest.mark.parametrize("dof", ["x", "z"])
@pytest.mark.parametrize("features", ["{}", "{view='birdseye', shape='moments'}"])
def test_gauss_newton_pulls_the_symbol_onto_its_place(dof, features):
    centroids, _ = run(f"{{name='gauss_newton', dof='{dof}'}}", 12, f"functions.symbol.features={features}")
    # it starts 50 % off; a tenth of a camera row, 20 cm here, is half a percent of the symbol's length
    assert centroids[-1].abs().max() < 1.0


@pytest.mark.parametrize("latency", [0, 3])
def test_latency_does_not_matter_to_the_model_reference(latency):
    centroids, _ = run("{name='model_reference', gain=1.0}", 8 + latency, f"camera.latency_steps={latency}")
    assert centroids[-1].abs().max() < 1.0
    assert centroids[6 + latency :].abs().max() < 2.0, "settled, and no limit cycle"


def test_a_height_keeps_the_width_that_a_place_loses():
    """On a road that is higher by a fifteenth of the lamp's height a flat rectangle's light is narrower than on its own height."""
    by_place, by_height = (run(f"{{name='model_reference', dof='{dof}'}}", 8)[1][-1] for dof in ("x", "z"))
    assert by_height > by_place


def test_feedforward_is_as_good_as_its_road():
    right, wrong, opened = (run(controller, 1)[1][0] for controller in (GIVEN, GIVEN[:-1] + ", offset_m=0.03}", "{name='open'}"))
    assert right > 0.93  # edges of half a camera row: a row is 20 cm of road here
    assert right > wrong + 0.3
    assert right > opened + 0.3


def test_a_given_road_is_followed_along_lines_of_sight():
    region, eye = Region(13.0, 21.0, 2.0, -2.0), torch.tensor([-1.6, 0.0, 1.35], dtype=torch.float64)
    flat = height_map_of(Flat().z, region, eye, 0.02)
    torch.testing.assert_close(
        flat.heights, torch.full_like(flat.heights, 0.02), rtol=0, atol=2e-5
    )  # 7 cm of way in 2^12 halves, by the slope
    curb = height_map_of(Curb(y_m=0.5, height_m=0.1).z, region, eye)
    # what is seen at the step's foot lies at y = 0.5 on the road, what is seen at its top appears at y = 0.5 * 1.35 / 1.25 = 0.54
    assert (curb.heights[:, : int((2.0 - 0.6) / 0.1)] > 0.099).all()
    assert (curb.heights[:, int((2.0 - 0.4) / 0.1) :].abs() < 2e-5).all()
