"""Controllers of the user's own: named in the scenario, checked with a sentence each."""

import pytest

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.loop.scenario.model import load
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of
from tests.refusal import sentence

OWN = """
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand

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
"""
SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=180", "camera.oversampling=2"]


@pytest.mark.usefixtures("own")
def test_a_controller_of_ones_own_is_named_in_the_scenario() -> None:
    scenario = load("flat", [*SMALL, "functions.symbol.controller={name='own:Halfway', options={share=0.25}}"])
    simulation = simulation_of(scenario)
    state, first = simulation.step(simulation.start())
    first = simulation.evaluate(first)
    _, second = simulation.step(state)
    second = simulation.evaluate(second)
    assert simulation.symbol.controller.inner.share == 0.25
    assert (second.symbol.pose - first.symbol.pose + 0.25 * first.symbol.measurement.pose_error).abs().max() < 1e-6
    assert isinstance(simulation.symbol.controller.projection(state.symbols["symbol"].controller, None), ProjectionCommand)
    again = type(scenario).model_validate_json(scenario.model_dump_json())
    assert again == scenario, "recordings hold it"


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("controller", "words"),
    [
        ("{name='no_such_module_at_all:Halfway'}", ["no_such_module_at_all", "PYTHONPATH"]),
        ("{name='own:Quarterway'}", ["own", "no Quarterway"]),
        ("{name='own:Halfway', options={gain=1}}", ["functions.symbol: controller.options", "gain"]),
        ("{name='own:Speechless'}", ["no method start", "projection"]),
        ("{name='own:'}", ["functions.symbol.controller.name", "pattern"]),
    ],
)
def test_what_is_wrong_with_it_is_said_in_a_sentence(controller: str, words: list[str]) -> None:
    with sentence(*words):
        simulation_of(load("flat", [*SMALL, f"functions.symbol.controller={controller}"]))
