"""Builds closed-loop symbols from a scenario: sensor, evaluator, controller, and checks that the light can be drawn and measured."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import BaseBeam
from luxloop.controllers.functions.planner import Plan, Planner
from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.situation import Situation
from luxloop.controllers.symbol import AnyParams, build_controller
from luxloop.controllers.symbol.heights.feedforward import FeedforwardParams
from luxloop.controllers.symbol.sensing.flat_model import flat_model
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector, SymbolParams
from luxloop.controllers.symbol.sensing.protocol import SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.build_lamps import drawing_modules
from luxloop.loop.simulation.build_scene import find_road
from luxloop.loop.simulation.controlled import ControlledSymbol, brightness
from luxloop.loop.simulation.lamps import ShiningModule
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.road_metrics import SymbolEvaluator
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams, camera_view, saturation_luminance
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.roads.base import Road
from luxloop.world.symbols import load_still


def build_symbols(
    scenario: Scenario, modules: Sequence[ShiningModule], planner: Planner, world: World | None, cache: PartCache
) -> Mapping[str, ControlledSymbol]:
    """The closed-loop symbols of a scenario by name, from top to bottom. world: the true world, None without the truth.

    Raises LuxloopError for a missing or broken file, a symbol that the lamps cannot draw or the camera cannot see, or a user's controller
    that cannot be made.
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
            evaluator = cache(f"{name}: evaluator", _symbol_evaluator, sensor, world, find_road(scenario.road), *optics)
            controller = cache(f"{name}: controller", build_symbol_controller, function.controller, sensor)
            symbols[name] = ControlledSymbol(function, drawn_by, sensor, controller, evaluator)
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


def _symbol_evaluator(sensor: SymbolSensor, world: World | None, road: Road, *optics: Any) -> SymbolEvaluator | None:
    """Evaluator of a symbol, None without the truth. Raises LuxloopError as `check_light`."""
    evaluator, (function, base, *_) = None, optics
    if world is not None:
        true_sensor = sensor if world.camera == sensor.camera else _sensor(world.camera, *optics)
        flat_luminance = true_sensor.model.luminance(sensor.projector.light(sensor.projector.target))
        evaluator = SymbolEvaluator.of(world, function.held, road, flat_luminance)
    check_light(sensor, evaluator, base["name"])
    return evaluator


def build_symbol_controller(params: AnyParams, sensor: SymbolSensor) -> SymbolController:
    """The controller of a symbol. Raises LuxloopError for a missing road file, or a user's controller that cannot be made."""
    if isinstance(params, FeedforwardParams):
        params = params.model_copy(update={"road": find_road(params.road)})
    return build_controller(params, sensor)


def check_light(sensor: SymbolSensor, evaluator: SymbolEvaluator | None, beam: str) -> None:
    """Raises LuxloopError if the lamps cannot draw the symbol at its target, or the camera cannot measure it there.

    beam: name of the base beam.
    """
    projector, camera, model = sensor.projector, sensor.camera, sensor.model
    where = _target(projector.params)
    if projector.params.quantity == "u_rel" and not any(bool(each.u.any()) for each in projector.resting):
        raise LuxloopError('quantity: u_rel is a multiple of the base beam, but there is none; give lighting.base.beam = "low", say')
    if evaluator is not None and not evaluator.goal.mask.any():
        if beam != "off" and model.beams.any():
            raise LuxloopError(f"{where} is nowhere brighter than the {beam} beam; raise value, or name a dimmer beam")
        raise LuxloopError(
            f"{where} is out of the lamps' reach, or the symbol is too small for their pixels ({_pixels_there(projector)}); move it, "
            "draw it larger, or let another lamp draw it"
        )
    if not (model.gains.isfinite() & (model.gains != 0)).all():
        raise LuxloopError(
            f"{where} cannot be distinguished from noise on a flat road ({_pixels_there(projector)}); raise value or "
            "headlight.intensity_cd, draw the symbol larger or with wider strokes, or take a lamp with finer pixels or a finer camera"
        )
    brightest = float(brightness(sensor, evaluator) + model.beams.median())
    if evaluator is not None:
        brightest += float(_without_headlamps(sensor, evaluator.world).median())
    if brightest > saturation_luminance(camera):
        raise LuxloopError(
            f"the symbol on the road has {brightest:.3g} cd/m^2, but the camera saturates at "
            f"{saturation_luminance(camera):.3g} cd/m^2; shorten camera.exposure_s, or raise camera.saturation_e"
        )


def _without_headlamps(sensor: SymbolSensor, world: World) -> Tensor:
    """Luminance `[h, w]` in cd/m^2 of a flat road at the symbol's target, in all light except the vehicle's headlamps."""
    target = ProjectionCommand(sensor.projector.target)
    crop = sensor.projector.footprint(target, world.view, sensor.params.footprint_margin_m)
    road, scene = flat_road(world.view.within(*crop.slices), sensor.model.albedo), world.scene
    return ambient_luminance(road, scene.ambient_lx, scene.street_lamps, scene.spotlights_at(0.0))


def _target(symbol: SymbolParams) -> str:
    return f"the target at x_m = {symbol.x_m:g}, y_m = {symbol.y_m:g}"


def _pixels_there(projector: Projector) -> str:
    """Sizes of the finest pixel and of the symbol seen from the lamp, in degrees, as text for an error."""

    def size_deg(module: DrawingModule) -> tuple[float, float]:
        light = module.pixel_controller.headlight
        left, right, bottom, top = (math.degrees(math.atan(tangent)) for tangent in (light.left, light.right, light.bottom, light.top))
        return (left - right) / light.pixel_cols, (top - bottom) / light.pixel_rows

    symbol, module = projector.params, min(projector.modules, key=lambda each: math.prod(size_deg(each)))
    across, down = size_deg(module)
    height = max(float(module.T_body_headlight[2, 3]), 0.1)  # a mount may put it below the road
    distance, half = math.hypot(symbol.x_m, symbol.y_m), 0.5 * symbol.length_m
    width_deg = math.degrees(2 * math.atan2(0.5 * symbol.width_m, distance))
    length_deg = math.degrees(math.atan2(height, distance - half) - math.atan2(height, distance + half))
    return (
        f"a pixel of {module.name} spans about {across:.3g} x {down:.3g} deg across and down, and the symbol "
        f"{width_deg:.3g} x {length_deg:.3g} deg seen from the lamp"
    )
