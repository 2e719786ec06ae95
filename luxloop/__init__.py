"""Closed loops around HD matrix headlights: simulate the lamp, the road and the camera, and control the light from what the camera sees.

    import luxloop

    result = luxloop.run("snowflake")
    print(result.summary["functions"]["symbol"]["iou_final"])

A notebook shows `result` as the report of the run. What is named here is the public interface; the insides of `world`, `perception`,
`controllers` and `loop` may change. Names are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from world.errors import did_you_mean

if TYPE_CHECKING:
    from controllers.functions.planner import LightingParams, Planner
    from controllers.pixels.primitives import concatenate, rectangle, road_symbol
    from controllers.pixels.ssc import Ssc, Utilisation
    from controllers.situation import Situation, TrackedObject
    from controllers.symbol import build_controller
    from controllers.symbol.sensing.projection import ProjectionCommand
    from controllers.symbol.sensing.protocol import Observation, SymbolController
    from controllers.symbol.sensing.symbol_sensor import SymbolSensor
    from loop.client.client import Client, connect
    from loop.contracts.controller import check_controller
    from loop.contracts.detector import check_detector
    from loop.contracts.function import check_function
    from loop.contracts.plant import check_plant
    from loop.contracts.tracker import check_tracker
    from loop.environment.making import make, make_vec
    from loop.environment.randomised import Randomised, RandomisedVector
    from loop.lighting.simulation import Simulation
    from loop.pictures.headlight import show as show_headlight
    from loop.plant.protocol import Arrivals, Exposure, Frame
    from loop.plant.simulated import simulated_plant
    from loop.rig.camera import CameraPicture
    from loop.run import RunResult, prepare, run
    from loop.scenario.model import Scenario
    from loop.scenario.model import load as load
    from loop.scenario.model import validate as validate
    from loop.scenario.shown import Shown, show
    from perception.detection.protocol import Detections
    from perception.egomotion import Ego, Sample
    from perception.extraction import Loss
    from perception.tracks import TrackedBoxes
    from world.errors import LuxloopError
    from world.frames import pose_from_degrees
    from world.headlight.lamp import Lamp, Module, ModuleCommand
    from world.lampfiles.description import load_lamp
    from world.photometry import read as read_photometry
    from world.presets import idealised
    from world.regulation import aim as aim_beam
    from world.regulation import check as check_beam
    from world.roads.base import RoadModel

__all__ = [
    "Arrivals",
    "CameraPicture",
    "Client",
    "Detections",
    "Ego",
    "Exposure",
    "Frame",
    "Lamp",
    "LightingParams",
    "Loss",
    "LuxloopError",
    "Module",
    "ModuleCommand",
    "Observation",
    "Planner",
    "ProjectionCommand",
    "Randomised",
    "RandomisedVector",
    "RoadModel",
    "RunResult",
    "Sample",
    "Scenario",
    "Shown",
    "Simulation",
    "Situation",
    "Ssc",
    "SymbolController",
    "SymbolSensor",
    "TrackedBoxes",
    "TrackedObject",
    "Utilisation",
    "aim_beam",
    "build_controller",
    "check_beam",
    "check_controller",
    "check_detector",
    "check_function",
    "check_plant",
    "check_tracker",
    "concatenate",
    "connect",
    "idealised",
    "load",
    "load_lamp",
    "make",
    "make_vec",
    "pose_from_degrees",
    "prepare",
    "read_photometry",
    "rectangle",
    "road_symbol",
    "run",
    "show",
    "show_headlight",
    "simulated_plant",
    "validate",
]

_MODULES = {
    "controllers.functions.planner": ("LightingParams", "Planner"),
    "controllers.pixels.primitives": ("concatenate", "rectangle", "road_symbol"),
    "controllers.pixels.ssc": ("Ssc", "Utilisation"),
    "controllers.situation": ("Situation", "TrackedObject"),
    "controllers.symbol": ("build_controller",),
    "controllers.symbol.sensing.projection": ("ProjectionCommand",),
    "controllers.symbol.sensing.symbol_sensor": ("SymbolSensor",),
    "controllers.symbol.sensing.protocol": ("Observation", "SymbolController"),
    "loop.client.client": ("Client", "connect"),
    "loop.contracts.controller": ("check_controller",),
    "loop.contracts.detector": ("check_detector",),
    "loop.contracts.function": ("check_function",),
    "loop.contracts.plant": ("check_plant",),
    "loop.contracts.tracker": ("check_tracker",),
    "loop.environment.making": ("make", "make_vec"),
    "loop.environment.randomised": ("Randomised", "RandomisedVector"),
    "loop.pictures.headlight": ("show as show_headlight",),
    "loop.plant.protocol": ("Arrivals", "Exposure", "Frame"),
    "loop.plant.simulated": ("simulated_plant",),
    "loop.rig.camera": ("CameraPicture",),
    "loop.run": ("RunResult", "prepare", "run"),
    "loop.scenario.model": ("Scenario", "load as load", "validate as validate"),
    "loop.lighting.simulation": ("Simulation",),
    "loop.scenario.shown": ("Shown", "show"),
    "perception.detection.protocol": ("Detections",),
    "perception.egomotion": ("Ego", "Sample"),
    "perception.extraction": ("Loss",),
    "perception.tracks": ("TrackedBoxes",),
    "world.errors": ("LuxloopError",),
    "world.frames": ("pose_from_degrees",),
    "world.headlight.lamp": ("Lamp", "Module", "ModuleCommand"),
    "world.lampfiles.description": ("load_lamp",),
    "world.photometry": ("read as read_photometry",),
    "world.presets": ("idealised",),
    "world.regulation": ("aim as aim_beam", "check as check_beam"),
    "world.roads.base": ("RoadModel",),
}
_HOMES = {each.split()[-1]: (module, each.split()[0]) for module, names in _MODULES.items() for each in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'luxloop' has no attribute {name!r}; {did_you_mean(name, __all__)}")
    module, attribute = _HOMES[name]
    globals()[name] = value = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    return __all__
