"""Where a symbol is aimed on a road of known shape: its look where that can be had, its place, or the nearest place that is lit."""

import pytest
import torch

from luxloop import load
from luxloop.controllers.symbol.sensing.field import aim, elsewhere
from luxloop.controllers.symbol.sensing.projector import Projector, SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import HERE, height
from luxloop.world.frames import inverse, transform
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

EYE = torch.tensor([0.0, 0.0, 1.3], dtype=torch.float64)


def projector() -> Projector:
    small = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=180", "renderer=raycast"]
    return simulation_of(load("flat", small)).symbol.projector


def symbol(target: str) -> SymbolParams:
    return projector().params.model_copy(update={"target": target})


def plane(shape: tuple[float, ...], target: str) -> torch.Tensor:
    return aim(torch.tensor(shape), symbol(target), projector().modules, EYE)


def grade(percent: float) -> tuple[float, ...]:
    """From 3 m on, about the target at 17 m."""
    return (percent / 100 * 14, percent / 100, 0.0, 0.0)


@pytest.mark.parametrize("percent", [-3, -2, 0, 2, 6])
def test_an_appearance_stays_one_while_it_meets_the_road(percent):
    assert plane(grade(percent), "appearance").equal(HERE)


def test_an_appearance_that_would_lie_too_far_behind_becomes_the_nearest_place_that_is_lit():
    found = elsewhere(plane(grade(-5), "appearance"), symbol("appearance"))
    assert found is not None and found.allclose(elsewhere(plane(grade(-5), "place"), symbol("place")))


@pytest.mark.parametrize("percent", [-2, 1, 4, 6])
def test_a_place_touches_the_road_at_the_target(percent):
    T = plane(grade(percent), "place")
    x = torch.tensor([15.0, 17.0, 19.0], dtype=torch.float64)
    on_plane = transform(T, torch.stack([x, torch.zeros_like(x), torch.zeros_like(x)]))
    # A grade is a plane; along it 2 m are 4 mm shorter seen from above at 6 %.
    assert torch.allclose(on_plane[0], x, atol=5e-3)
    assert torch.allclose(on_plane[2], height(torch.tensor(grade(percent)).double(), 17.0, on_plane[0], on_plane[1]), atol=1e-6)
    assert elsewhere(T, symbol("place")) is None


def test_a_place_below_the_field_moves_ahead_until_lamps_light_all_of_it():
    T = plane(grade(-4), "place")
    found = elsewhere(T, symbol("place"))
    assert found is not None and found[0] > 20 and found[1] == pytest.approx(0.0, abs=1e-9)
    corners = torch.tensor([[19.0, 19.0, 15.0, 15.0], [1.0, -1.0, 1.0, -1.0], [0.0] * 4], dtype=torch.float64)
    module = projector().modules[0]
    x, _, z = transform(inverse(module.T_body_headlight.double()), transform(T, corners))
    light = module.pixel_controller.headlight
    assert bool((z / x >= light.bottom).all()) and bool((z / x <= light.top).all())
    # A step nearer the nearest corner would be below the field.
    nearer = transform(T, corners)[0].min() - 0.5
    below = (height(torch.tensor(grade(-4)).double(), 17.0, nearer, torch.tensor(0.0)) - module.T_body_headlight[2, 3]) / nearer
    assert below < light.bottom


def test_a_place_behind_a_crest_is_not_aimed_at():
    crest = (-1.5, -0.25, 0.0, -1 / 60)  # falls away from the lamps' lowest light
    found = elsewhere(plane(crest, "place"), symbol("place"))
    assert found is None or found[0] < 17


def test_where_nothing_can_be_lit_the_target_stays():
    assert plane((-30.0, -3.0, 0.0, 0.0), "place").equal(HERE)
