"""Closed-loop symbols among the lighting functions: drawing, measurement and control, and how a scenario's are built."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import BaseBeam
from luxloop.controllers.functions.planner import Plan, Planner
from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.pixels.primitives import Primitives, concatenate
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import LAYERS, Situation, TrackedObject
from luxloop.controllers.symbol import AnyParams, ControllerParams, build_controller
from luxloop.controllers.symbol.heights.feedforward import FeedforwardParams, OpenLoopParams
from luxloop.controllers.symbol.heights.height_map import Belief
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector, SymbolParams
from luxloop.controllers.symbol.sensing.symbol_sensor import (
    Measurement,
    Observation,
    Projection,
    SymbolController,
    SymbolSensor,
    flat_model,
    flat_transports,
)
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.lamps import ShiningModule, drawing_modules
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.projections import view_from
from luxloop.loop.simulation.protocol import ExposurePair
from luxloop.loop.simulation.road_metrics import SymbolEvaluator
from luxloop.loop.simulation.simulated import body_of, find_road
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams, camera_view, saturation_luminance
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.light.emitters import ambient_luminance, sun_luminance
from luxloop.world.light.illumination import added_light
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.roads.base import Road
from luxloop.world.symbols import load_still
from luxloop.world.texels import Window

ORIGIN: Final = Situation(0.0, torch.eye(4), torch.zeros(0, 3))  # the ground frame, without objects
SAME = 1e-4  # difference of utilisations within rounding


@dataclass(frozen=True)
class SymbolState:
    """State of a symbol. controller: controller state. turn: step of the last measurement.

    shape: road shape `[4]` at the last measurement, None for a flat road.
    """

    controller: Any
    turn: int = -1
    shape: Tensor | None = None


@dataclass(frozen=True, eq=False)
class ControlledSymbol:
    """A closed-loop symbol.

    drawn_by: indices of the modules that draw the symbol. evaluator: None without the truth.
    """

    function: SymbolFunctionParams
    drawn_by: tuple[int, ...]
    sensor: SymbolSensor
    controller: SymbolController
    evaluator: SymbolEvaluator | None

    @property
    def params(self) -> ControllerParams:
        """Controller parameters."""
        assert self.function.controller is not None
        return self.function.controller

    @property
    def projector(self) -> Projector:
        """Projector that draws the symbol."""
        return self.sensor.projector

    @cached_property
    def brightness(self) -> Tensor:
        """Median luminance `[]` in cd/m^2 of the symbol at its target on a flat road."""
        return brightness(self.sensor, self.evaluator)

    def in_open_loop(self) -> "ControlledSymbol":
        """The symbol in open loop, drawn at its target for a flat road."""
        return replace(self, controller=build_controller(OpenLoopParams(), self.sensor))

    def belief(self, state: SymbolState, ego: Ego | None) -> Belief | None:
        """What the controller believes about road and body at the next exposure; None without a height map."""
        belief: Callable[[Any, Ego | None], Belief] | None = getattr(self.controller, "belief", None)
        return None if belief is None else belief(state.controller, ego)

    def start(self) -> SymbolState:
        """The state before the first measurement."""
        return SymbolState(self.controller.start(self.function.start_pose.pose.to(self.projector.target)))

    def command(self, projection: ProjectionCommand, T_ground_body: Tensor | None) -> tuple[Primitives, ...]:
        """Primitives of a projection in the ground frame; empty if the projection sets pixels directly.

        T_ground_body: `[4, 4]`, None for a standing, level body.
        """
        if projection.raw is not None:
            return ()
        function, parts = self.function, []
        for module, primitive in zip(self.projector.modules, self.projector.primitives(projection, clear=True), strict=True):
            drawn = replace(
                primitive,
                weight=torch.full_like(primitive.weight, function.weight),
                forced=torch.full_like(primitive.forced, function.forced),
                priority=torch.full_like(primitive.priority, function.priority * LAYERS),
                modules=((module.name,),),
                shared=torch.zeros_like(primitive.shared),
            )
            parts.append(drawn if T_ground_body is None else drawn.transform(T_ground_body))
        return (concatenate(*parts),)

    def light(self, on: Sequence[Utilisation], off: Sequence[Utilisation]) -> tuple[Utilisation, ...]:
        """Utilisations of the drawing modules with the symbol on the assumed base beams, one a module.

        on, off: utilisations of all modules with and without the symbol.
        """
        beams = zip(self.drawn_by, self.projector.resting, strict=True)  # equal to off without other functions
        return tuple(on[k] if off[k].u is beam.u else Utilisation(beam.u + on[k].u - off[k].u) for k, beam in beams)

    def step(
        self, state: SymbolState, name: str, pair: ExposurePair, ego: Ego | None, latency_steps: int
    ) -> tuple[SymbolState, Measurement]:
        """Measure a pair that shows the symbol, and step its controller. name: of the symbol. ego: newest estimated motion.
        latency_steps: steps since the pair was exposed.
        """
        shown = Projection(pair.on.projections[name], self.light(pair.on.lights, pair.off.lights), pair.ego)
        frames = self.sensor.compensate(pair.images, shown.lights) if pair.measures(name) else None
        bias = None if pair.alone or frames is None else self._bias(shown)
        if bias is not None and not bool(bias.isfinite().all()):
            frames, seen = None, replace(self.sensor.lost(shown.projection.pose, ExtractionStatus.COVERED), shape=state.shape)
        else:
            seen = self.sensor.measure(frames, shown.projection, shown.lights, state.shape if ego is None or ego.stands else None)
            if bias is not None and seen.code == ExtractionStatus.SEEN:
                errors = seen.errors - bias
                seen = replace(seen, errors=errors, pose_error=self.sensor.pose_error(errors))
        after = self.controller.step(state.controller, Observation(seen, frames, shown, ego, latency_steps))
        return SymbolState(after, state.turn, seen.shape), seen

    def _bias(self, shown: Projection) -> Tensor | None:
        """Feature bias caused by other functions' light, `[4]`; NaN if they leave too little of the symbol to measure. None if they do not
        affect it, or if it could not be measured on a flat road even alone.
        """
        alone = self.projector.draw(shown.projection)
        if all(torch.allclose(a.u, b.u, rtol=0, atol=SAME) for a, b in zip(shown.lights, alone, strict=True)):
            return None
        left, whole = (self.sensor.render(shown.projection, lights) for lights in (shown.lights, alone))
        return left - whole if bool(whole.isfinite().all()) else None

    def footprint(self, projection: ProjectionCommand) -> Window:
        """Image window of a projection in the camera, with a margin."""
        return self.projector.footprint(projection, self.sensor.model.eye.view, self.sensor.params.footprint_margin_m)


def choose_measured(
    symbols: Mapping[str, ControlledSymbol], states: Mapping[str, SymbolState], projections: Mapping[str, ProjectionCommand]
) -> tuple[str, ...]:
    """Symbols to measure together in a step: the longest unmeasured first, with separate image windows."""
    if len(projections) < 2:
        return tuple(projections)
    taken: dict[str, Window] = {}
    for name in sorted(projections, key=lambda name: (states[name].turn, name)):
        where = symbols[name].footprint(projections[name])
        if not any(where.meets(other) for other in taken.values()):
            taken[name] = where
    return tuple(taken)


def brightness(sensor: SymbolSensor, evaluator: SymbolEvaluator | None) -> Tensor:
    """Median luminance `[]` in cd/m^2 of the symbol at its target on a flat road."""
    if evaluator is not None and evaluator.view is None:
        return evaluator.goal.median
    flat = sensor.model.luminance(sensor.projector.light(sensor.projector.target))
    return flat[flat > THRESHOLD * flat.max()].median()


def build_symbols(
    scenario: Scenario, modules: Sequence[ShiningModule], planner: Planner, world: World | None, cache: PartCache
) -> Mapping[str, ControlledSymbol]:
    """The closed-loop symbols of a scenario by name, from top to bottom. world: the true world, None without the truth.

    Raises LuxloopError for a missing or broken file, a symbol that the lamps cannot draw or the camera cannot see, or a user's controller
    that cannot be made.
    """
    base = planner.compose(ORIGIN, planner.start(), {}).base
    names = [name for name in planner.functions if name in scenario.symbols]
    symbols = {}
    for name in names:
        with locate(f"functions.{name}"):
            function = place(scenario.symbols[name], scenario)
            drawn_by = drawing_modules(function, modules)
            drawn = function.model_copy(update={"controller": None, "start": None})
            optics = drawn, vars(base), tuple(modules[k] for k in drawn_by), scenario.surface, scenario.light.ambient_lx
            sensor = cache(f"{name}: sensor", _sensor, scenario.camera, *optics)
            evaluator = cache(f"{name}: evaluator", _symbol_evaluator, sensor, world, find_road(scenario.road), *optics)
            controller = cache(f"{name}: controller", build_symbol_controller, function.controller, sensor)
            symbols[name] = ControlledSymbol(function, drawn_by, sensor, controller, evaluator)
    return symbols


def place(symbol: SymbolFunctionParams, scenario: Scenario) -> SymbolFunctionParams:
    """A symbol of a scenario on the flat road, where its observer sees it when it begins; raises as `SymbolFunctionParams.placed`."""
    if symbol.observer is None:
        return symbol
    time_s, road = symbol.start_s or 0.0, find_road(scenario.road)
    bodies = (body_of(item, road) for item in scenario.all_objects if item.name == symbol.observer.name)
    return symbol.placed(replace(ORIGIN, time_s=time_s, objects=tuple(TrackedObject.of(each, "other", time_s) for each in bodies)))


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
    observer = None if function.observer is None else torch.tensor(function.observer.eye_m, dtype=torch.float64)
    image = function.on_flat_road(image, ORIGIN)
    projector = Projector(drawing, image, function.held, camera_view(camera).origin, observer)
    model = flat_model(projector, camera, surface, ambient_lx, function.extraction, function.features)
    return SymbolSensor(projector, model, camera, function.extraction)


def _symbol_evaluator(sensor: SymbolSensor, world: World | None, road: Road, *optics: Any) -> SymbolEvaluator | None:
    """Evaluator of a symbol, None without the truth. Raises LuxloopError as `check_light`."""
    evaluator, (function, base, _, surface, _) = None, optics
    if world is not None:
        projector = sensor.projector
        light = projector.light(projector.target)
        if projector.observer is None:
            true_sensor = sensor if world.camera == sensor.camera else _sensor(world.camera, *optics)
            evaluator = SymbolEvaluator.of(world, function.held, road, true_sensor.model.luminance(light))
        else:
            view = view_from(projector.observer, function)
            dark = torch.zeros(view.height, view.width, device=projector.symbol.device)
            transports = flat_transports(projector, view, surface)[1]
            flat_luminance = added_light(transports, light, dark) - added_light(transports, projector.resting, dark)
            evaluator = SymbolEvaluator.of(world, function.held, road, flat_luminance, view)
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
    lit = ambient_luminance(road, scene.ambient_lx, scene.street_lamps, scene.spotlights_at(0.0))
    return lit if scene.sun is None else lit + sun_luminance(road, scene.sun)


def _target(symbol: SymbolParams) -> str:
    return f"the target at x_m = {symbol.x_m:g}, y_m = {symbol.y_m:g}"


def _pixels_there(projector: Projector) -> str:
    """Sizes of the finest pixel and of the symbol seen from the lamp, in degrees, as text for an error."""

    def size_deg(module: DrawingModule) -> tuple[float, float]:
        light = module.pixel_controller.headlight
        left, right, bottom, top = light.borders_deg
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
