"""From a scenario to its plant."""

from collections.abc import Sequence
from typing import cast

from loop.assembly.made import Made
from loop.assembly.truth import LampModule
from loop.plant.clock import FromZero
from loop.plant.protocol import Plant
from loop.plant.recorded import recorded_plant
from loop.plant.remote import remote_plant
from loop.plant.simulated import simulated_plant
from loop.scenario.model import Scenario
from loop.scenario.plant import RecordedPlantParams, RemotePlantParams, SimulatedPlantParams
from world import plugin

KEY = "plant.kind"
METHODS = ("start", "show")


def build_plant(scenario: Scenario, modules: Sequence[LampModule], made: Made | None = None) -> Plant:
    """A plant whose time begins at 0. Raises LuxloopError where a file is missing or broken, or a plant of one's own cannot be made."""
    params = scenario.plant
    if isinstance(params, SimulatedPlantParams):
        return simulated_plant(scenario, modules, made)
    if isinstance(params, RecordedPlantParams):
        return recorded_plant(scenario, params, modules)
    like = modules[0].headlight.matrix.values
    if isinstance(params, RemotePlantParams):
        return FromZero(remote_plant(scenario, params, modules), f"{KEY}: {params.kind}", scenario.camera, like)
    given = {"scenario": scenario, "modules": modules}
    plant = cast(Plant, plugin.make(params.kind, KEY, given, params.options, METHODS))
    return FromZero(plant, f"{KEY}: {params.kind}", scenario.camera, like)
