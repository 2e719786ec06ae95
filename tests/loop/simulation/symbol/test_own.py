"""Controllers, extractions and roads of the user's own: named in the scenario, used wherever ours are, and refused in a sentence."""

from dataclasses import dataclass
from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop import Observation, ProjectionCommand, Scenario, Simulation, load
from luxloop.controllers.symbol import FeedforwardParams
from luxloop.perception.extraction import ExtractionParams, OwnExtractionParams, symbol_image
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of
from tests.refusal import sentence

OWN = """
import numpy as np
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.perception import extraction
from luxloop.world.roads.base import MeshGrid, RoadModel
from luxloop.world.roads.shapes import SpeedBump

class Halfway:
    def __init__(self, sensor, share=0.5):
        self.share = share
    def start(self, pose):
        return pose
    def projection(self, state, ego):
        return ProjectionCommand(state)
    def step(self, state, observation):
        return state - self.share * observation.measurement.pose_error.nan_to_num()

class Speechless:
    def __init__(self, sensor):
        pass

class Ours:
    def __init__(self, edges="grey"):
        self.params = extraction.ExtractionParams(edges=edges)
    def symbol_image(self, contrast, limit):
        return extraction.symbol_image(contrast, limit, self.params)

class Pooled(Ours):
    def symbol_image(self, contrast, limit):
        return contrast[..., ::2, ::2]

class Elsewhere(Ours):
    def symbol_image(self, contrast, limit):
        return contrast.to("meta")

class Blind:
    pass

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


def scenario(*overrides: str) -> Scenario:
    small = "camera={ width_px=320, height_px=180, oversampling=2 }"
    found = load("flat", [f"headlight.model={SMALL_LAMP}", small, *overrides])
    assert type(found).model_validate_json(found.model_dump_json()) == found, "recordings hold it"
    return found


@pytest.mark.usefixtures("own")
def test_a_controller_draws_what_it_wants():
    simulation = simulation_of(scenario("functions.symbol.controller={name='own:Halfway', options={share=0.25}}"))
    state, first = simulation.step(simulation.start())
    _, second = simulation.step(state)
    first, second = simulation.evaluate(first), simulation.evaluate(second)
    controller = simulation.symbol.controller
    assert controller.inner.share == 0.25
    assert (second.symbol.pose - first.symbol.pose + 0.25 * first.symbol.measurement.pose_error).abs().max() < 1e-6
    assert isinstance(controller.projection(state.symbols["symbol"].controller, None), ProjectionCommand)


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("controller", ["luxloop", "model_reference"])
def test_the_loop_looks_with_an_extraction(controller):
    """Ours by another name sees, expects and registers the same on bumps, bit for bit; other edges do not."""

    def looked(extraction: str) -> tuple[Any, Tensor]:
        keys = ("road.kind=bumps", "steps=3", f"functions.symbol.controller.name={controller}", f"functions.symbol.extraction={extraction}")
        simulation = simulation_of(scenario(*keys))
        return simulation.scenario.symbol, torch.stack([result.symbol.measurement.errors for result in simulation.evaluations()])

    _, as_own = looked("{kind='own:Ours', options={edges='binary'}, area_low=0.3}")
    symbol, as_ours = looked("{edges='binary', area_low=0.3}")
    _, by_default = looked("{area_low=0.3}")
    assert torch.equal(as_own, as_ours) and not torch.equal(as_own, by_default)
    assert isinstance(symbol.extraction, ExtractionParams)


def test_batches_and_devices_are_passed_on(device):
    own = OwnExtractionParams(kind=f"{__name__}:Lit")
    contrast, limit = torch.rand(2, 3, 8, 6, device=device), torch.full((8, 6), 0.4, device=device)
    assert symbol_image(contrast, limit, own).equal((contrast > limit).to(contrast))


class Lit:
    def symbol_image(self, contrast: Tensor, limit: Tensor) -> Tensor:
        return (contrast > limit).to(contrast)


@pytest.mark.usefixtures("own")
def test_a_road_lies_and_is_believed_in_as_the_same_road_of_ours():
    """A speed bump by another name shows and draws bit for bit the same; `luxloop check` would call it by its name."""
    runs = []
    for road in ("{kind='own:Bump', options={height_m=0.05}}", "{kind='speed_bump', height_m=0.05}"):
        given = scenario(f"road={road}", f"functions.symbol.controller={{name='feedforward', road={road}}}")
        assert isinstance(given.symbol.controller, FeedforwardParams)
        _, result = (simulation := simulation_of(given)).step(simulation.start())
        runs.append((*result.frames, result.lights[0]))
    assert all(one.equal(other) for one, other in zip(*runs, strict=True))


WRONG = {
    "functions.symbol.controller={name='no_such_module_at_all:Halfway'}": "controller.name: no_such_module_at_all:Halfway: ",
    "functions.symbol.controller={name='own:Quarterway'}": "own has no Quarterway",
    "functions.symbol.controller={name='own:Halfway', options={gain=1}}": "functions.symbol: controller.options",
    "functions.symbol.controller={name='own:Speechless'}": "no method start",
    "functions.symbol.controller={name='own:'}": "functions.symbol.controller.name",
    "functions.symbol.extraction={kind='own:Ours', options={edge='grey'}}": "functions.symbol: extraction.options",
    "functions.symbol.extraction={kind='own:Blind'}": "no method symbol_image",
    "functions.symbol.extraction={kind='own:Pooled'}": "an image like that",
    "functions.symbol.extraction={kind='own:Elsewhere'}": "on meta for",
    "road={kind='own:Along', options={rise='much'}}": "road.options.rise: is the text 'much'; write a number",
    "road={kind='own:Heightless'}": "no method z",
    "road={kind='own:Shapeless'}": "one a place",
    "road={kind='own:Bottomless'}": "not finite",
    "road={kind='washboard'}": "road.kind",
}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(("override", "words"), WRONG.items())
def test_what_is_wrong_is_said_in_a_sentence(override, words):
    with sentence(words):
        list(simulation_of(scenario(override, "steps=1")).evaluations())


LATE = [
    f"headlight.model={SMALL_LAMP}",
    "camera={ width_px=160, height_px=90, oversampling=1, latency_steps=2 }",
    "road={kind='flat'}",
    "renderer=raycast",
]


@dataclass(frozen=True)
class Numbering:
    """Numbers its commands; the state is the pose, the next number, and the numbers that came back."""

    def start(self, pose):
        return pose, 0, ()

    def projection(self, state, ego):
        return ProjectionCommand(state[0], data=state[1])

    def step(self, state, observation: Observation):
        pose, number, back = state
        return pose, number + 1, (*back, observation.shown.projection.data if observation.frames is not None else None)


def test_data_come_back_with_the_frames_that_show_the_command():
    simulation = Simulation.prepare(load("snowflake", LATE, steps=5)).with_controller(Numbering())
    state = simulation.start()
    for _ in range(5):
        state, _ = simulation.step(state)
    assert state.symbols["symbol"].controller[2] == (None, None, 0, 1, 2)
