"""Metrics of a step: light on objects, materials and the road, observed symbols, and closed-loop symbols against their targets.

The loop and its controllers never use them.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.functions.animations import animate
from luxloop.controllers.functions.planner import Plan, Planner
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import Situation
from luxloop.controllers.symbol.heights.feedforward import height_map_of, region_around
from luxloop.controllers.symbol.heights.height_map import Belief
from luxloop.controllers.symbol.sensing.field import cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.simulation.attribution import attribute
from luxloop.loop.simulation.columns import MOTION
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.detection import DetectionPipeline, Recognition, false_positives, name_of, recognise
from luxloop.loop.simulation.lamps import LampDriver, Lights, attitude
from luxloop.loop.simulation.light_figures import (
    DUE_S,
    InZone,
    ObservedSymbol,
    OnMaterial,
    OnObject,
    illuminance_at,
    in_white,
    in_zones,
    must_be_dark,
    near_enough,
    observed_symbols,
    on_eyes,
    on_materials,
    on_objects,
    veils_at,
)
from luxloop.loop.simulation.projections import ProjectionMetrics, projection_metrics
from luxloop.loop.simulation.result import Clock, StepResult, mean_lights, without
from luxloop.loop.simulation.road_metrics import over_setpoint
from luxloop.loop.simulation.world import ObjectLight, World, categories
from luxloop.perception.camera import expose
from luxloop.perception.detection.detector import Detections
from luxloop.perception.eye import threshold_increment
from luxloop.perception.metrics import Metrics
from luxloop.perception.noise import FrameNoise
from luxloop.perception.tracking import TrackedBoxes
from luxloop.world.frames import inverse, transform
from luxloop.world.headlight.lamp import Commands
from luxloop.world.regulation import Result
from luxloop.world.roads.base import Road
from luxloop.world.scene.vehicle import STANDING, VehiclePath, VehicleState
from luxloop.world.traffic.tracked import ROAD_USERS


def projections_by_cause(
    symbol: ControlledSymbol, belief: Belief | None, vehicle: VehicleState, road: Road
) -> dict[str, ProjectionCommand]:
    """Projections by column of `luxloop.loop.simulation.columns.CAUSES`: in open loop, and of a belief with pose, road and both made true.

    belief: of the controller; None: pose and road cannot be made true one by one. vehicle: the true one.
    """
    plane = HERE if belief is None else belief.T_ground_plane
    region = region_around(symbol.sensor) if belief is None else belief.relief.region
    projector, pose = symbol.projector, vehicle.T_ground_body
    true_eye = transform(inverse(plane) @ pose, projector.eye[:, None].to(pose))[:, 0]

    def seen_from(eye: Tensor) -> Belief:
        relief = height_map_of(road.z, region, eye, T_ground_plane=vehicle.T_world_ground @ plane)
        return Belief(relief, plane, pose)

    drawn = {"iou_open": ProjectionCommand(projector.target), "iou_true": seen_from(true_eye).draw(projector)}
    if belief is not None:
        drawn["iou_true_pose"] = replace(belief, T_ground_body=pose).draw(projector)
        drawn["iou_true_road"] = replace(seen_from(belief.relief.eye), T_ground_body=belief.T_ground_body).draw(projector)
    return drawn


UNKNOWN = torch.tensor(math.nan)


@dataclass(frozen=True, eq=False)
class SymbolStep:
    """A closed-loop symbol in one step. projection: the projection shown. cut: `[4]`, shares beyond the borders of the lamps' field
    (`luxloop.controllers.symbol.sensing.field`). measurement: from the newest frames. metrics: None in a step without evaluation.
    road_true_m, road_believed_m: `[]`, mean height of the road, and of the controller's height map, in the target's area, above the plane
    of the ground; NaN if unknown or without evaluation. causes: `[]` each, by column of `luxloop.loop.simulation.columns.CAUSES`; none
    without evaluation or `judge_causes`.
    """

    projection: ProjectionCommand
    cut: Tensor
    measurement: Measurement
    metrics: Metrics | None
    road_true_m: Tensor = UNKNOWN
    road_believed_m: Tensor = UNKNOWN
    causes: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def pose(self) -> Tensor:
        """Shown pose `[4]`: x, y in m, roll, pitch in rad."""
        return self.projection.pose

    @property
    def z(self) -> Tensor:
        """Height `[]` in m of the symbol's centre above the assumed road."""
        return torch.zeros_like(self.pose[0]) if self.projection.z is None else self.projection.z

    @property
    def aim(self) -> Tensor:
        """Place `[2]` in m, x and y, where the symbol is aimed instead of its target; NaN for the target."""
        return torch.full_like(self.pose[:2], torch.nan) if self.projection.aim is None else self.projection.aim.to(self.pose)


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """Detections in the newest frame, empty without a frame, and the current tracks at its time.

    recognised: by name of each visible object. false_positives: detections scored high enough for a new track that overlap no object,
    None without the truth. eyes_lx_max, eyes_lx_peak: largest illuminance from the lamps on visible heads and windscreens of road users,
    time mean and peak, None if none is visible. oncoming_lx_max: time mean on oncoming ones due for dimming. causes: counts by column of
    `luxloop.loop.simulation.attribution.WHY`; none without evaluation or `judge_causes`.
    """

    found: Detections
    tracks: TrackedBoxes
    recognised: Mapping[str, Recognition] = field(default_factory=dict)
    false_positives: int | None = None
    eyes_lx_max: float | None = None
    eyes_lx_peak: float | None = None
    oncoming_lx_max: float | None = None
    causes: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Glare:
    """Veiling luminance in an eye by the lamps, and its threshold increment; NaN while its object does not exist."""

    veil_cd_m2: float
    ti_percent: float


@dataclass(frozen=True, eq=False)
class Evaluation(StepResult):
    """A step with its metrics.

    masked: names of objects that must be dark. illuminance: `[height, width]` lx from the lamps alone, None if not metered. luminance:
    `[height, width]` cd/m^2 of all light. Both are in the camera's view, computed on access, None without the truth. objects: recorded
    objects by name. detections: None without a detector. since_s: times since which the camera sees objects, by name, with a detector and
    `judge_causes`. symbols: symbols for an observer, in the observer's view. held: closed-loop
    symbols by name. zones, materials: by name. road_lx_ratio_max: see `over_setpoint`, None in a step without evaluation. oncoming_s:
    start times, by name, of near oncoming road users. probes: illuminance in lx by name, a mean over the exposures. glare: by name of a
    probe that is an eye. projections: symbols on the road as the driver sees them, by name; none in a step without evaluation, or without
    `judge_projections`. rules: requirements that the base beam fails, by rule that a check names. body: heave in m, roll and
    pitch in deg of the body over the ground, "true" at the start of the step and as "measured" last; of moving vehicles.
    """

    masked: frozenset[str]
    illuminance: Tensor | None
    luminance: Tensor | None
    objects: Mapping[str, OnObject]
    detections: FrameDetections | None
    since_s: Mapping[str, float]
    symbols: tuple[ObservedSymbol, ...]
    held: Mapping[str, SymbolStep]
    zones: Mapping[str, InZone]
    materials: Mapping[str, OnMaterial]
    road_lx_ratio_max: float | None
    oncoming_s: Mapping[str, float]
    probes: Mapping[str, float]
    glare: Mapping[str, Glare]
    projections: Mapping[str, ProjectionMetrics]
    rules: Mapping[str, tuple[Result, ...]]
    body: Mapping[str, tuple[float, float, float]]

    @property
    def symbol(self) -> SymbolStep:
        """The only closed-loop symbol shown. Raises LuxloopError if there are several or none."""
        return self.held[only(self.held)]

    @property
    def dark_lx_max(self) -> float | None:
        """Largest illuminance in lx on objects that must be dark; None if none is visible."""
        found = [each.lx_max for each in self.objects.values() if each.masked and each.pixels]
        return max(found, default=None)

    @property
    def symbol_iou_min(self) -> float | None:
        """Smallest overlap of an observed symbol with its wanted picture; None without such a symbol."""
        return min((each.iou for each in self.symbols), default=None)


@dataclass(frozen=True, eq=False)
class Evaluator:
    """Computes a step's metrics from parts of the simulation. world: the true world, None if the plant does not know it."""

    scenario: Scenario
    planner: Planner
    pipeline: DetectionPipeline | None
    controlled: Mapping[str, ControlledSymbol]
    lamps: LampDriver
    world: World | None

    @cached_property
    def recorded_ids(self) -> Mapping[str, int]:
        """Ids of the recorded objects by name: tracked objects, or with a detector all detectable objects."""
        if self.world is None:
            return {}
        given = [item.category for item in self.scenario.all_objects] if self.pipeline is None else categories(self.world.given)
        named = enumerate(zip(self.world.scene.objects, given, strict=True), 1)
        return {body.name: number for number, (body, category) in named if category is not None}

    @property
    def _meter(self) -> World | None:
        """The true world, None if its illuminance is not metered."""
        return self.world if self.world is not None and self.world.metered else None

    def evaluate(self, result: StepResult, before: Evaluation | None = None) -> Evaluation:
        """The step with its metrics. before: evaluation of the previous step, None for the first."""
        clock, now, meter, shares = Clock(), result.now, self._meter, self.scenario.shares
        metered = [] if meter is None else [meter.on_objects(each.start_s, each.lights, each.commands) for each in result.exposures]
        oncoming_s = self._oncoming(now, before)
        due = self.world is not None and bool(self.scenario.judge_every) and result.step % self.scenario.judge_every == 0
        since_s = self._since(now, before)
        detections = self._detections(result, metered, oncoming_s, since_s if due else {})
        masked = frozenset(each.name for each in now.objects if must_be_dark(self.scenario.functions, each, now))
        ids = self._ids(detections)
        illuminance, luminance = self._images(result)
        objects: Mapping[str, OnObject] = {}
        materials: Mapping[str, OnMaterial] = {}
        if meter is not None and illuminance is not None and luminance is not None:
            objects = on_objects(self.recorded_ids, frozenset(ids[name] for name in masked & ids.keys()), metered, shares)
            materials = on_materials(self.planner.functions, result.perception.functions, now, ids, meter, illuminance, luminance)
        view = result.sense.view if self.world is None else self.world.view_from_ground(now.time_s)
        evaluation = Evaluation(
            **vars(result),
            masked=masked,
            illuminance=illuminance,
            luminance=luminance,
            objects=objects,
            detections=detections,
            since_s=since_s,
            symbols=self._observed_symbols(result),
            held=self._held(result, due),
            zones=in_zones(self.planner.functions, result.planning.functions, luminance, view),
            materials=materials,
            road_lx_ratio_max=self._road_ratio(result) if due else None,
            oncoming_s=oncoming_s,
            probes=self._probes(result),
            glare=self._glare(result),
            projections=self._projections(result) if due else {},
            rules=self._rules(result.plan, before),
            body=self._body(result),
        )
        clock.lap("look")
        return replace(
            evaluation, timings={key: result.timings.get(key, 0.0) + clock.ms.get(key, 0.0) for key in {**result.timings, **clock.ms}}
        )

    def _rules(self, plan: Plan, before: Evaluation | None) -> Mapping[str, tuple[Result, ...]]:
        same = before is not None and not self.scenario.lighting.raw and before.plan.base.undimmed == plan.base.undimmed
        if before is not None and same and before.rules.keys() == set(self.scenario.rules):
            return before.rules
        return {rule: self.lamps.failures(plan, rule) for rule in self.scenario.rules}

    def _probes(self, result: StepResult) -> Mapping[str, float]:
        if (world := self.world) is None or not self.scenario.probes:
            return {}
        return self._mean(result, partial(illuminance_at, self.scenario.probes, world))

    def _glare(self, result: StepResult) -> Mapping[str, Glare]:
        """Glare in the eyes at probes, by name."""
        eyes = {name: each for name, each in self.scenario.probes.items() if each.adaptation_cd_m2 is not None}
        if (world := self.world) is None or not eyes:
            return {}
        veils = self._mean(result, partial(veils_at, eyes, world, age_years=self.scenario.video.age_years))
        return {name: Glare(veil, threshold_increment(veil, eyes[name].adaptation_cd_m2 or math.nan)) for name, veil in veils.items()}

    def _mean(self, result: StepResult, of: Callable[[float, Lights, Commands], Mapping[str, float]]) -> Mapping[str, float]:
        """Mean values by name over a step's exposures."""
        each = [of(exposure.start_s, exposure.lights, exposure.commands) for exposure in result.exposures]
        return {name: sum(share * values[name] for share, values in zip(self.scenario.shares, each, strict=True)) for name in each[0]}

    @cached_property
    def _path(self) -> VehiclePath:
        assert self.world is not None
        return VehiclePath.of(self.world.motion, self.scenario.steps / self.scenario.rate_hz)

    def _projections(self, result: StepResult) -> Mapping[str, ProjectionMetrics]:
        """Shown symbols on the road, by name."""
        assert self.world is not None
        found, now, planning = {}, result.now, result.planning
        lights = mean_lights(result, self.scenario.shares)
        for name, symbol in self.scenario.projections.items():
            if planning.drawn.get(name) or name in planning.projections:
                off = result.off.lights if planning.measured == (name,) else self._lights_without(result, name)
                image = animate(self.planner.symbols[symbol.image], symbol.animation, now.time_s - (symbol.start_s or 0.0))
                found[name] = projection_metrics(self.world, self._path, symbol, image, now.time_s, lights, off, now.commands)
        return found

    def _lights_without(self, result: StepResult, name: str) -> tuple[Utilisation, ...]:
        """Light of all functions but a symbol."""
        now, planning = result.now, result.planning
        return self.lamps.drive(self.planner.compose(now, planning.functions, without(planning.drawn, [name])), now)[0]

    def _oncoming(self, now: Situation, before: Evaluation | None) -> Mapping[str, float]:
        """Start times of near oncoming road users, by name; empty without a detector or metered light."""
        if self.pipeline is None or self._meter is None:
            return {}
        return near_enough(self._meter.lit(now.time_s), {} if before is None else before.oncoming_s, now.time_s)

    def _since(self, now: Situation, before: Evaluation | None) -> Mapping[str, float]:
        """Times since which the camera sees objects, by name; empty without a detector, metered light or `judge_causes`."""
        if self.pipeline is None or self._meter is None or not self.scenario.judge_causes:
            return {}
        known = {} if before is None else before.since_s
        return {each.name: known.get(each.name, now.time_s) for each in self._meter.lit(now.time_s).objects}

    def _ids(self, detections: FrameDetections | None) -> Mapping[str, int]:
        """Ids of objects by their names in lighting functions: with a detector, names of tracks."""
        ids = self.recorded_ids
        if detections is None:
            return ids
        found = ((each.track, ids.get(name)) for name, each in detections.recognised.items())
        return {name_of(track): number for track, number in found if track is not None and number is not None}

    def _images(self, result: StepResult) -> tuple[Tensor | None, Tensor | None]:
        """Illuminance, None if not metered, and luminance of the first exposure; both None without the truth."""
        world, like = self.world, result.lights[0]
        if world is None:
            return None, None
        shown = result.now.time_s, result.exposures[0].lights, result.now.commands
        luminance = world.image(like, lambda part: world.luminance(*shown, part)[0])
        return world.image(like, lambda part: world.illuminance(*shown)[part]) if world.metered else None, luminance

    def _detections(
        self, result: StepResult, metered: list[ObjectLight], oncoming_s: Mapping[str, float], since_s: Mapping[str, float]
    ) -> FrameDetections | None:
        """Detections in the newest frame, None without a detector. metered: light on objects in each exposure of this step. since_s: of
        objects in sight, empty without attribution.
        """
        if self.pipeline is None:
            return None
        perception, classes = result.perception, self.pipeline.classes
        found = perception.found or Detections(torch.zeros(0, 4), torch.zeros(0, len(classes)))
        present = self.pipeline.present(perception.tracks, perception.taken_s)
        if not metered or self.world is None:
            return FrameDetections(found, present)
        then = self.world.lit(perception.taken_s)
        false = false_positives(then, found, self.scenario.tracker.start_score)
        due = [name for name, came_s in oncoming_s.items() if result.now.time_s - came_s >= DUE_S]  # dimming is overdue
        eyes = on_eyes(self.world.given, due, metered, self.scenario.shares)
        recognised = recognise(then, present, found, classes)
        known = FrameDetections(found, present, recognised, false, *eyes)
        return replace(known, causes=self._causes(result, known, metered, since_s)) if since_s else known

    def _causes(
        self, result: StepResult, known: FrameDetections, metered: list[ObjectLight], since_s: Mapping[str, float]
    ) -> Mapping[str, int]:
        """Counts by column of `luxloop.loop.simulation.attribution.WHY`. known: detections and tracks. Others as of `_detections`."""
        world = self.world
        assert world is not None
        users = [each.name for each in world.given if each.category in ROAD_USERS and each.name in since_s]
        eyes_lx = {name: on_eyes(world.given, [name], metered, self.scenario.shares)[2] or 0.0 for name in users}
        seen_s = {name: result.now.time_s - time_s for name, time_s in since_s.items()}
        view, find = world.lit(result.perception.taken_s), partial(self._find_in_full_light, result)
        return attribute(view, known.recognised, known.tracks, eyes_lx, seen_s, find)

    def _find_in_full_light(self, result: StepResult) -> Detections:
        """Detections with all pixels on at the time of the newest frame."""
        assert self.pipeline is not None and self.world is not None
        camera, taken_s = self.scenario.camera, result.perception.taken_s
        lights = tuple(Utilisation(torch.ones_like(each.flux)) for each in self.lamps.modules)
        noise = FrameNoise.of(self.scenario.seed, result.step, 0) if camera.noise else None
        frame = expose(self.world.luminance(taken_s, lights)[0], camera, noise)
        return self.pipeline.find(frame / (2**camera.bits - 1), self.world.lit(taken_s))

    def _observed_symbols(self, result: StepResult) -> tuple[ObservedSymbol, ...]:
        """Symbols in their observers' views, relative to white pictures; empty without metered light."""
        if self._meter is None or (white := in_white(result.plan)) is None:
            return ()
        whitened = [light.u for light in self.lamps.drive(white, result.now)[0]]
        return observed_symbols(result.plan, result.lights, whitened, self._meter, result.now)

    def _body(self, result: StepResult) -> Mapping[str, tuple[float, float, float]]:
        """Heave in m, roll and pitch in deg of the body, by source; empty for a standing vehicle."""
        found = {}
        if self.world is not None and self.world.motion is not STANDING:
            now = self.world.motion.at(result.time_s)
            found["true"] = now.heave_m, math.degrees(now.roll_rad), math.degrees(now.pitch_rad)
        if result.sense.ego is not None:
            heave_m, *angles = result.sense.ego.attitude.tolist()
            found["measured"] = heave_m, *map(math.degrees, angles)
        return found

    def _held(self, result: StepResult, due: bool) -> Mapping[str, SymbolStep]:
        """The closed-loop symbols, by name. due: whether they are evaluated."""
        found = {}
        for name, each in result.planning.projections.items():
            figures = {"metrics": None} | (self._figures(result, name) if due else {})
            found[name] = SymbolStep(each, cut(self.controlled[name].projector, each), result.control.measurements[name], **figures)
        return found

    def _road_ratio(self, result: StepResult) -> float | None:
        """Largest ratio of illuminance to setpoint on the road; None without a detector, functions, or metered light."""
        if self._meter is None or self.pipeline is None or not self.planner.functions:
            return None
        lit = self._meter.lit(result.now.time_s)
        return over_setpoint(self.lamps.aim(result.now), result.plan, result.exposures[0].lights, lit)

    def _figures(self, result: StepResult, name: str) -> dict[str, Any]:
        """Figures of a symbol, if measured, in an evaluated step, from the light with the symbol minus the light without it."""
        now, measured, symbol = result.now, result.planning.measured, self.controlled[name]
        if name not in measured:
            return {}
        evaluator, world, belief = symbol.evaluator, self.world, symbol.belief(result.planning.symbols[name], result.sense.ego)
        assert evaluator is not None and world is not None
        off = result.off.lights if len(measured) == 1 else self._lights_without(result, name)
        causes = dict[str, Tensor]()

        def metrics(lights: Lights) -> Metrics:
            return evaluator.evaluate(lights, off, now.time_s, now.commands)

        shown = metrics(result.exposures[0].lights)
        if self.scenario.judge_causes:
            projections = projections_by_cause(symbol, belief, world.motion.at(now.time_s), evaluator.road)
            drawn = {key: metrics(self.redraw(result, name, each)) for key, each in projections.items()}
            causes = {key: each.iou for key, each in drawn.items()}
            if world.motion is not STANDING:
                last = result.exposures[self.scenario.drawings[0] - 1]
                end_s = last.start_s + last.duration_s
                causes["iou_end"] = evaluator.evaluate(last.lights, off, end_s, last.commands).iou
            if (true_pose := drawn.get("iou_true_pose")) is not None:
                causes |= zip(MOTION, shown.centroid_percent - true_pose.centroid_percent, strict=True)
        return {
            "metrics": shown,
            "road_true_m": evaluator.heights(now.time_s).mean(),
            "road_believed_m": UNKNOWN if belief is None else belief.heights(*evaluator.area[:2].to(world.device).float()).mean(),
            "causes": causes,
        }

    def redraw(self, result: StepResult, name: str, projection: ProjectionCommand) -> Lights:
        """Light of a step with another projection of a symbol."""
        ego, planning = result.sense.ego, result.planning
        drawn = {**planning.drawn, name: self.controlled[name].command(projection, None if ego is None else attitude(ego))}
        return self.lamps.drive(self.planner.compose(result.now, planning.functions, drawn), result.now)[0]
