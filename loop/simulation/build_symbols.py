"""From a scenario to its symbols under control: sensor, judge, controller."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from luxloop.controllers.functions.base_beams import BaseBeam
from luxloop.controllers.functions.planner import Plan, Planner
from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.situation import Situation
from luxloop.controllers.symbol import AnyParams, build_controller
from luxloop.controllers.symbol.heights.feedforward import FeedforwardParams
from luxloop.controllers.symbol.sensing.flat_model import flat_model
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector
from luxloop.controllers.symbol.sensing.protocol import SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.build_lamps import drawing_modules
from luxloop.loop.simulation.build_scene import find_road
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.feasible import check_light
from luxloop.loop.simulation.judging import Judge
from luxloop.loop.simulation.lamps import ShiningModule
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.errors import locate
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.roads.base import Road
from luxloop.world.symbols import load_still


def build_symbols(
    scenario: Scenario, modules: Sequence[ShiningModule], planner: Planner, world: World | None, cache: PartCache
) -> Mapping[str, ControlledSymbol]:
    """The symbols of a scenario by name, from top to bottom. world: what is true, None where the plant does not know it.

    Raises LuxloopError where a file is missing or broken, lamps cannot draw a symbol, the camera cannot see it, or a controller of the
    user's own cannot be made.
    """
    base = planner.compose(Situation(0.0, torch.eye(4), torch.zeros(0, 3)), planner.start(), {}).base
    names = [name for name in planner.functions if name in scenario.symbols]
    symbols = {}
    for name in names:
        with locate(f"functions.{name}"):
            function = scenario.symbols[name]
            drawn_by = drawing_modules(function, modules)
            drawn = function.model_copy(update={"controller": None, "start": None})
            optics = drawn, vars(base), tuple(modules[k] for k in drawn_by), scenario.surface, scenario.light.ambient_lx
            sensor = cache(f"{name}: sensor", _sensor, scenario.camera, *optics)
            judge = cache(f"{name}: judge", _judge, sensor, world, find_road(scenario.road), *optics)
            controller = cache(f"{name}: controller", build_symbol_controller, function.controller, sensor)
            symbols[name] = ControlledSymbol(function, drawn_by, sensor, controller, judge)
    return symbols


def _sensor(
    camera: CameraParams,
    function: SymbolFunctionParams,
    base: Mapping[str, Any],
    modules: Sequence[ShiningModule],
    surface: RoadSurfaceParams,
    ambient_lx: float,
) -> SymbolSensor:
    plan = Plan(0.0, BaseBeam(**base), None)
    drawing = tuple(DrawingModule(each.name, each.controller.over(each.base(plan)), each.T_world_module) for each in modules)
    with locate("image"):
        image = load_still(find_file(function.image, "symbols")).to(modules[0].flux.device)
    projector = Projector(drawing, image, function.held, camera_view(camera).origin)
    model = flat_model(projector, camera, surface, ambient_lx, function.extraction, function.features)
    return SymbolSensor(projector, model, camera, function.extraction)


def _judge(sensor: SymbolSensor, world: World | None, road: Road, *optics: Any) -> Judge | None:
    """None where the plant does not know the truth. Raises LuxloopError as `check_light`."""
    judge, (function, base, *_) = None, optics
    if world is not None:
        true_sensor = sensor if world.camera == sensor.camera else _sensor(world.camera, *optics)
        flat_luminance = true_sensor.model.luminance(sensor.projector.light(sensor.projector.target))
        judge = Judge.of(world, function.held, road, flat_luminance)
    check_light(sensor, judge, base["name"])
    return judge


def build_symbol_controller(params: AnyParams, sensor: SymbolSensor) -> SymbolController:
    """The controller of a symbol. Raises LuxloopError where a road's file is missing, or a controller of one's own cannot be made."""
    if isinstance(params, FeedforwardParams):
        params = params.model_copy(update={"road": find_road(params.road)})
    return build_controller(params, sensor)
