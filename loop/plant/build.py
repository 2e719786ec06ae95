"""From a scenario to its plant."""

from typing import cast

from controllers.symbol.sensing.projector import Projector
from loop.plant.protocol import Plant
from loop.plant.recorded import recorded_plant
from loop.plant.simulated import simulated_plant
from loop.scenario.model import Scenario
from loop.scenario.plant import RecordedPlantParams, SimulatedPlantParams
from world import plugin

KEY = "plant.kind"
METHODS = ("start", "show")


def build_plant(scenario: Scenario, projector: Projector) -> Plant:
    """Raises LuxloopError where a file is missing or broken, or a plant of one's own cannot be made."""
    params = scenario.plant
    if isinstance(params, SimulatedPlantParams):
        return simulated_plant(scenario, projector)
    if isinstance(params, RecordedPlantParams):
        return recorded_plant(scenario, params, projector)
    given = {"scenario": scenario, "projector": projector}
    return cast(Plant, plugin.make(params.kind, KEY, given, params.options, METHODS))
