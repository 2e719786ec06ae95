"""Builds a simulation and its plant from a scenario: check, then build the parts in order of dependence."""

from collections.abc import Sequence
from typing import Any, cast

import torch

from luxloop.controllers.functions.planner import Planner
from luxloop.controllers.pixels.secondary import PotentialLight
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RecordedPlantParams, RemotePlantParams, RigPlantParams, SimulatedPlantParams
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.check import check, check_truth
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.controlled import build_symbols
from luxloop.loop.simulation.detection import DetectionPipeline
from luxloop.loop.simulation.lamps import lamp_modules, mount, shining_module
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Plant
from luxloop.loop.simulation.simulated import digitised_plant, simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import camera_view
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.rendering.rasterise import check_process

KEY = "plant.kind"
METHODS = ("start", "show")


def build(scenario: Scenario, device: torch.device, cache: PartCache) -> dict[str, Any]:
    """Fields of `Simulation`. Raises LuxloopError as `check`, for a missing or broken file, or if a user's part fails."""
    check_process()
    mounts = cache("mounted modules", mount, scenario.headlight, str(device))
    check(scenario, mounts)
    planner = Planner.prepare(scenario.functions, scenario.lighting, lambda image: find_file(image, "symbols"))
    modules = tuple(shining_module(scenario, each, cache) for each in mounts)
    plant = build_plant(scenario, cache("lamp modules", lamp_modules, mounts), cache)
    truth, view, detector = getattr(plant, "truth", None), camera_view(scenario.camera), scenario.detector
    check_truth(scenario, truth is not None)
    pipeline = None
    if detector is not None:
        parts = detector, scenario.tracker, scenario.camera
        pipeline = cache("pipeline", lambda *_: DetectionPipeline.prepare(detector, scenario.tracker, view, device), *parts)
    return {
        "planner": planner,
        "modules": modules,
        "lights": tuple((module.name, PotentialLight.of(module.headlight, module.T_world_module)) for module in modules),
        "view": view,
        "plant": plant,
        "pipeline": pipeline,
        "controlled": build_symbols(scenario, modules, planner, truth, cache),
    }


class Unconnected:
    """A hardware plant without a rig, for checking a scenario; it cannot be started."""

    def start(self) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        raise LuxloopError(f"{KEY}: no rig is connected; run it with `luxloop run NAME --rig FILE`, or play a recording of it with --plant")

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        return self.start()


def build_plant(scenario: Scenario, modules: Sequence[LampModule], cache: PartCache) -> Plant:
    """A scenario's plant, with time from 0. Raises LuxloopError for a missing or broken file, or a user's plant that cannot be made."""
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
    """The plant with its clock shifted to 0 at the start, and its arrivals checked."""
    return FromZero(plant, f"{KEY}: {scenario.plant.kind}", scenario.camera, modules[0].headlight.matrix.values)
