"""What a simulation is made of."""

from typing import Any

import torch

from luxloop.controllers.functions.planner import Planner
from luxloop.controllers.pixels.secondary import Light
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import named
from luxloop.loop.simulation.build_plant import build_plant
from luxloop.loop.simulation.commanded import refuse_commands
from luxloop.loop.simulation.controlled import controlled_symbols
from luxloop.loop.simulation.detection import DetectionPipeline
from luxloop.loop.simulation.lamps import lamp_modules, shining_modules
from luxloop.loop.simulation.made import Made
from luxloop.loop.simulation.names import check_names, refuse_unknown
from luxloop.perception.camera import camera_view
from luxloop.world.rendering.rasterise import check_process


def parts(scenario: Scenario, device: torch.device, made: Made) -> dict[str, Any]:
    """Fields of `Simulation`. Raises LuxloopError where something is missing, beams included, or broken, and as `check_process`."""
    check_process()
    planner = Planner.prepare(scenario.functions, scenario.lighting, lambda image: named(image, "symbols"))
    modules = shining_modules(scenario, device, made)
    check_names(scenario, modules)
    where = tuple((each.name, each.headlight, each.T_world_module) for each in modules)
    plant = build_plant(scenario, made("lamp modules", where, lambda: tuple(lamp_modules(modules))), made)
    truth = getattr(plant, "truth", None)
    refuse_unknown(scenario, truth is not None)
    controlled = controlled_symbols(scenario, modules, planner, truth, made)
    refuse_commands(planner, modules, controlled)
    view, given, tracker = camera_view(scenario.camera), scenario.detector, scenario.tracker
    pipeline = None
    if given is not None:
        of_pipeline = given, tracker, scenario.camera
        pipeline = made("pipeline", of_pipeline, lambda: DetectionPipeline.prepare(given, tracker, view, device))
    lights = tuple((module.name, Light.of(module.headlight, module.T_world_module)) for module in modules)
    return {
        "planner": planner,
        "modules": modules,
        "lights": lights,
        "view": view,
        "plant": plant,
        "pipeline": pipeline,
        "controlled": controlled,
    }
