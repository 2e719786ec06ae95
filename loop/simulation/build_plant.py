"""From a scenario to its plant."""

from collections.abc import Sequence
from typing import cast

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RecordedPlantParams, RemotePlantParams, RigPlantParams, SimulatedPlantParams
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.digitised import digitised_plant
from luxloop.loop.simulation.made import Made
from luxloop.loop.simulation.protocol import Plant
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.simulation.unconnected import Unconnected
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError

KEY = "plant.kind"
METHODS = ("start", "show")


def build_plant(scenario: Scenario, modules: Sequence[LampModule], made: Made | None = None) -> Plant:
    """A plant whose time begins at 0. Raises LuxloopError where a file is missing or broken, or a plant of one's own cannot be made."""
    params = scenario.plant
    if scenario.digitised is not None and not isinstance(params, SimulatedPlantParams | RecordedPlantParams):
        raise LuxloopError(
            f"modules.{scenario.digitised}.source: a digitised beam lights the simulated world, but the plant is {params.kind}; "
            'set plant.kind = "simulated"'
        )
    if isinstance(params, SimulatedPlantParams):
        return simulated_plant(scenario, modules, made) if scenario.digitised is None else digitised_plant(scenario, modules, made)
    if isinstance(params, RecordedPlantParams):
        from luxloop.loop.simulation.recorded import recorded_plant

        return recorded_plant(scenario, params, modules)
    if isinstance(params, RigPlantParams):
        return Unconnected()
    if isinstance(params, RemotePlantParams):
        from luxloop.loop.simulation.remote_plant import remote_plant

        return from_zero(remote_plant(scenario, params, modules), scenario, modules)
    given = {"scenario": scenario, "modules": modules}
    plant = cast(Plant, plugin.make(params.kind, KEY, given, params.options, METHODS))
    return from_zero(plant, scenario, modules)


def from_zero(plant: Plant, scenario: Scenario, modules: Sequence[LampModule]) -> Plant:
    """A plant whose clock may begin at any time, as one whose time begins at 0; what it gives is looked at."""
    return FromZero(plant, f"{KEY}: {scenario.plant.kind}", scenario.camera, modules[0].headlight.matrix.values)
