"""Roads of the user's own: wherever a road is named, and refused in a sentence."""

from typing import Any

import pytest

from luxloop.controllers.symbol import FeedforwardParams
from luxloop.loop.scenario.model import load
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of
from tests.refusal import sentence

OWN = """
import numpy as np
from luxloop.world.roads.base import MeshGrid, RoadModel
from luxloop.world.roads.shapes import SpeedBump

class Bump(SpeedBump):
    pass

class Along(RoadModel):
    "Depends on x alone, as the class says and does."
    rise: float = 0.01
    def z(self, x, y):
        return self.rise * x

class Shapeless(Along):
    def z(self, x, y):
        return np.zeros(3)

class Bottomless(Along):
    def z(self, x, y):
        return np.where(x > 0, np.nan, 0.0)

class Heightless:
    def grid(self):
        return MeshGrid()
"""
SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=180", "camera.oversampling=2"]


@pytest.mark.usefixtures("own")
def test_it_lies_and_is_believed_in_as_the_same_road_of_ours() -> None:
    """A speed bump by another name shows and draws bit for bit the same; `luxloop check` would call it by its name."""
    own = "{kind='own:Bump', options={height_m=0.05}}"
    ours = "{kind='speed_bump', height_m=0.05}"
    runs = []
    for road in (own, ours):
        scenario = load("flat", [*SMALL, f"road={road}", f"functions.symbol.controller={{name='feedforward', road={road}}}"])
        assert isinstance(scenario.symbol.controller, FeedforwardParams)
        _, result = (simulation := simulation_of(scenario)).step(simulation.start())
        assert result.frames is not None
        runs.append((scenario, *result.frames, result.lights[0]))
    for one, other in zip(runs[0][1:], runs[1][1:], strict=True):
        assert one.equal(other)
    scenario = runs[0][0]
    assert type(scenario).model_validate_json(scenario.model_dump_json()) == scenario, "recordings hold it"


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("road", "words"),
    [
        ({"kind": "own:Along", "options": {"rise": "much"}}, ["road.options.rise: is the text 'much'; write a number"]),
        ({"kind": "own:Heightless"}, ["no method z", "z, grid"]),
        ({"kind": "own:Shapeless"}, ["(3,)", "one a place"]),
        ({"kind": "own:Bottomless"}, ["not finite"]),
        ({"kind": "washboard"}, ["road.kind", "package.module:Name"]),
    ],
)
def test_what_is_wrong_with_it_is_said_in_a_sentence(road: dict[str, Any], words: list[str]) -> None:
    with sentence("road", *words):
        simulation_of(load("flat", [*SMALL, {"road": road}]))
