"""From a scenario to its plant."""

from collections.abc import Sequence
from typing import Any, cast

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RecordedPlantParams, RemotePlantParams, RigPlantParams, SimulatedPlantParams
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.digitised import digitised_plant
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Plant
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError

KEY = "plant.kind"
METHODS = ("start", "show")


class Unconnected:
    """A plant of hardware to which nothing is connected, so that its scenario can be checked and read; it cannot be started."""

    def start(self) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        raise LuxloopError(f"{KEY}: no rig is connected; run it with `luxloop run NAME --rig FILE`, or play a recording of it with --plant")

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        return self.start()


def build_plant(scenario: Scenario, modules: Sequence[LampModule], cache: PartCache) -> Plant:
    """A plant whose time begins at 0. Raises LuxloopError where a file is missing or broken, or a plant of one's own cannot be made."""
    params = scenario.plant
    if isinstance(params, SimulatedPlantParams):
        return (simulated_plant if scenario.digitised_module is None else digitised_plant)(scenario, modules, cache)
    if isinstance(params, RecordedPlantParams):
        from luxloop.loop.simulation.recorded import recorded_plant

        return recorded_plant(scenario, params, modules)
    if isinstance(params, RigPlantParams):
        return Unconnected()
    if isinstance(params, RemotePlantParams):
        from luxloop.loop.simulation.remote import remote_plant

        return from_zero(remote_plant(scenario, params, modules), scenario, modules)
    given = {"scenario": scenario, "modules": modules}
    return from_zero(cast(Plant, plugin.make(params.kind, KEY, given, params.options, METHODS)), scenario, modules)


def from_zero(plant: Plant, scenario: Scenario, modules: Sequence[LampModule]) -> Plant:
    """A plant whose clock may begin at any time, as one whose time begins at 0; what it gives is checked."""
    return FromZero(plant, f"{KEY}: {scenario.plant.kind}", scenario.camera, modules[0].headlight.matrix.values)
