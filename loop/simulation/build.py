"""From a scenario to its simulation: first checked, then built part by part, in the order in which parts depend on each other."""

from typing import Any

import torch

from luxloop.controllers.functions.planner import Planner
from luxloop.controllers.pixels.secondary import Light
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.build_lamps import mount, shining_module
from luxloop.loop.simulation.build_plant import build_plant
from luxloop.loop.simulation.build_symbols import build_symbols
from luxloop.loop.simulation.check import check, check_truth
from luxloop.loop.simulation.detection import DetectionPipeline
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.perception.camera import camera_view
from luxloop.world.rendering.rasterise import check_process


def build(scenario: Scenario, device: torch.device, cache: PartCache) -> dict[str, Any]:
    """Fields of `Simulation`. Raises LuxloopError as `check`, and where a file is missing or broken, or a part of the user's own fails."""
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
        "lights": tuple((module.name, Light.of(module.headlight, module.T_world_module)) for module in modules),
        "view": view,
        "plant": plant,
        "pipeline": pipeline,
        "controlled": build_symbols(scenario, modules, planner, truth, cache),
    }
