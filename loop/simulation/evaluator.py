"""A step seen from outside: the light on objects, materials and the road, symbols from their observers' eyes, and how held symbols lie.

The loop and its controllers never ask it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from luxloop.controllers.functions.planner import Plan, Planner
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.controlled import ControlledSymbol, Held
from luxloop.loop.simulation.detection import DetectionPipeline, false_positives, recognised
from luxloop.loop.simulation.judging import over_setpoint
from luxloop.loop.simulation.lamps import LampDriver
from luxloop.loop.simulation.observed import ObservedSymbol, in_white, observed_symbols
from luxloop.loop.simulation.on_materials import InZone, OnMaterial, in_zones, on_materials
from luxloop.loop.simulation.on_objects import DUE_S, OnObject, light_on_objects, must_be_dark, near_enough, on_eyes, on_objects, told_as
from luxloop.loop.simulation.result import (
    Control,
    FrameDetections,
    Parts,
    Perception,
    Reception,
    SimulationState,
    StepDrive,
    StepPlan,
    without,
)
from luxloop.loop.simulation.world import ObjectLight, World, categories
from luxloop.perception.detection.detector import Detections
from luxloop.perception.metrics import Metrics


@dataclass(frozen=True, eq=False)
class Evaluation:
    """masked: names of objects that must be dark. illuminance: `[height, width]` lx from the lamps alone, None where nobody asks for it.
    luminance: in cd/m^2 with all other light. The camera sees both; they are computed where they are read, None without the truth.

    objects: by name, those that are there and have a category. look: None without a detector. symbols: those meant for an observer, from
    their eyes. held: those that controllers hold; zones, materials: all by name. road_lx_ratio_max: see `luxloop.loop.simulation.judging`,
    None where nobody judged.
    """

    masked: frozenset[str]
    illuminance: Tensor | None
    luminance: Tensor | None
    objects: Mapping[str, OnObject]
    look: FrameDetections | None
    symbols: tuple[ObservedSymbol, ...]
    held: Mapping[str, Held]
    zones: Mapping[str, InZone]
    materials: Mapping[str, OnMaterial]
    road_lx_ratio_max: float | None


@dataclass(frozen=True, eq=False)
class Evaluator:
    """world: what is true, None where the plant does not know it. The others are those of the simulation."""

    scenario: Scenario
    planner: Planner
    pipeline: DetectionPipeline | None
    controlled: Mapping[str, ControlledSymbol]
    lamps: LampDriver
    world: World | None

    @cached_property
    def watched(self) -> Mapping[str, int]:
        """Objects that are recorded, by name, and their ids: those that a tracker is told of, with a detector all that it ought to find."""
        if self.world is None:
            return {}
        told = [item.category for item in self.scenario.all_objects]
        wanted = enumerate(zip(self.world.scene.objects, told if self.pipeline is None else categories(self.world.given), strict=True), 1)
        return {body.name: number for number, (body, category) in wanted if category is not None}

    def evaluate(
        self, state: SimulationState, plan: StepPlan, drive: StepDrive, reception: Reception, perception: Perception, control: Control
    ) -> tuple[Evaluation, Mapping[str, float]]:
        """A step's evaluation, and since when those who come towards the car have been near enough.

        state: before the step.
        """
        now, world, lights, shares = plan.now, self.world, drive.exposures[0], self.scenario.shares
        metered = [] if world is None else light_on_objects(world, reception.showings)
        oncoming_s = near_enough(world.lit(now.time_s), state.oncoming_s, now.time_s) if self.pipeline and world and world.metered else {}
        detections = self._detections(perception, metered, [name for name, s in oncoming_s.items() if now.time_s - s >= DUE_S])
        masked = frozenset(each.name for each in now.objects if must_be_dark(self.scenario.functions, each, now))
        told = told_as(self.watched, None if detections is None else detections.recognised)
        luminance = None if world is None else world.image(now.time_s, lights, now.commands)
        illuminance = world.illuminance_image(now.time_s, lights, now.commands) if world is not None and metered else None
        view = perception.view if world is None else world.view_from_ground(now.time_s)
        objects: Mapping[str, OnObject] = {}
        materials: Mapping[str, OnMaterial] = {}
        symbols: tuple[ObservedSymbol, ...] = ()
        if world is not None and illuminance is not None and luminance is not None:
            objects = on_objects(self.watched, frozenset(told[name] for name in masked & told.keys()), metered, shares)
            materials = on_materials(self.planner.functions, perception.functions, now, told, world, illuminance, luminance)
            symbols = self._observed(plan, drive, world)
        judged = world is not None and bool(every := self.scenario.judge_every) and state.step % every == 0
        compared = judged and metered and self.pipeline is not None and self.planner.functions
        verdicts = self._verdicts(state, plan, drive) if judged and plan.measured else {}
        evaluation = Evaluation(
            masked,
            illuminance,
            luminance,
            objects,
            detections,
            symbols,
            {
                name: self.controlled[name].held(each, control.measurements.get(name), verdicts.get(name))
                for name, each in plan.projections.items()
            },
            in_zones(self.planner.functions, state.functions, luminance, view),
            materials,
            over_setpoint(self.lamps.aimed(now), plan.plans[0], lights, world.lit(now.time_s)) if compared and world else None,
        )
        return evaluation, oncoming_s

    def _detections(self, perception: Perception, metered: list[ObjectLight], due: list[str]) -> FrameDetections | None:
        """Of the newest frame, None without a detector. metered: light in each exposure of now. due: who must not be dazzled any more."""
        if self.pipeline is None:
            return None
        classes = self.pipeline.classes
        found = perception.found or Detections(torch.zeros(0, 4), torch.zeros(0, len(classes)))
        present = self.pipeline.present(perception.tracks, perception.taken_s)
        if not metered or self.world is None:
            return FrameDetections(found, present, {}, None, None, None, None)
        then = self.world.lit(perception.taken_s)
        false = false_positives(then, found, self.scenario.tracker.start_score)
        eyes = on_eyes(self.world.given, due, metered, self.scenario.shares)
        return FrameDetections(found, present, recognised(then, present, found, classes), false, *eyes)

    def _observed(self, plan: StepPlan, drive: StepDrive, world: World) -> tuple[ObservedSymbol, ...]:
        """Symbols meant for an observer, compared with an all-white picture."""
        first: Plan = plan.plans[0]
        if (white := in_white(first)) is None:
            return ()
        whitened = [light.u for light in self.lamps.drive(white, plan.now)[0]]
        return observed_symbols(first, [light.u for light in drive.exposures[0]], whitened, world, plan.now)

    def _verdicts(self, state: SimulationState, plan: StepPlan, drive: StepDrive) -> Mapping[str, Metrics]:
        """Of each symbol that is measured, from the light with it and without it."""
        verdicts, (on, off) = {}, drive.exposures
        for name in plan.measured:
            if len(plan.measured) > 1:
                others: Parts = without(plan.drawn, [name])
                off, _ = self.lamps.drive(self.planner.compose(plan.now, state.functions, others), plan.now)
            judge = self.controlled[name].judge
            assert judge is not None and self.world is not None
            verdicts[name] = judge.judged(self.world.added(plan.now.time_s, on, off, plan.now.commands), plan.now.time_s)
        return verdicts
