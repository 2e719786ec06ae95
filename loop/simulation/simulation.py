"""The control loop in steps of five acts: sense, plan, drive, expose, control."""

import math
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import BaseBeamParams, BeamName
from luxloop.controllers.functions.commands import compose
from luxloop.controllers.functions.planner import Planner
from luxloop.controllers.pixels.secondary import PotentialLight
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import CameraImage, ScheduleParams, Situation, TrackedObject
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement, SymbolController
from luxloop.loop.scenario.checks import Baseline
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.scenario.studio_window import StudioWindow
from luxloop.loop.simulation.build import at_rest, build
from luxloop.loop.simulation.controlled import ControlledSymbol, choose_measured
from luxloop.loop.simulation.detection import DetectionPipeline
from luxloop.loop.simulation.evaluator import Evaluation, Evaluator
from luxloop.loop.simulation.lamps import LampDriver, Lights, ShiningModule, attitude, in_reach, mean_powers
from luxloop.loop.simulation.meeting import meet
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.pixel_gain_loop import PixelGainLoop
from luxloop.loop.simulation.protocol import Arrivals, Exposure, ExposurePair, Objects, Plant, close_plant, pair_frames
from luxloop.loop.simulation.result import (
    Clock,
    Control,
    Drive,
    Parts,
    Perception,
    Reception,
    Sense,
    SimulationState,
    StepPlan,
    StepResult,
    without,
)
from luxloop.loop.simulation.simulated import world_plant
from luxloop.loop.simulation.world import LitScene, World
from luxloop.perception.camera import luminance_of, saturation_luminance
from luxloop.perception.egomotion import Ego, Samples, ego_of, recent
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.frames import View, inverse
from luxloop.world.headlight.lamp import REST, Commands
from luxloop.world.rendering.rasterise import check_process
from luxloop.world.scene.vehicle import Motion

SAME_S = 1e-6  # tolerance of equal times
BEAMS: Mapping[Baseline, BeamName] = {"full_light": "full", "low_beam": "low"}


@dataclass(frozen=True, eq=False)
class Simulation:
    """The runnable simulation of a scenario on one device.

    Lighting functions use the ground frame, which moves with the car. view: the calibrated camera view of a level car body. pipeline:
    detector and tracker, None without a detector. controlled: closed-loop symbols, by name. gain_loop: of the lamps' pixels, None without
    `pixel_gains`. cache: reusable parts.
    """

    scenario: Scenario
    device: torch.device
    planner: Planner
    modules: tuple[ShiningModule, ...]
    lights: tuple[tuple[str, PotentialLight], ...]
    view: View
    plant: Plant
    pipeline: DetectionPipeline | None = None
    controlled: Mapping[str, ControlledSymbol] = field(default_factory=dict)
    gain_loop: PixelGainLoop | None = None
    cache: PartCache = field(default_factory=PartCache)

    @classmethod
    def prepare(cls, scenario: Scenario, device: torch.device | str = "cpu", before: "Simulation | None" = None) -> "Simulation":
        """Build scene and lamps, load symbols, and plan a first step. Raises LuxloopError for a missing or broken part, beams included.

        before: an earlier simulation, whose unchanged parts are reused.
        """
        device = torch.device(device)
        cache = PartCache(None if before is None or before.device != device else before.cache)
        with locate(scenario.source):
            simulation = cls(scenario, device, cache=cache, **build(scenario, device, cache))
            simulation.planner.plan(simulation.situation(0.0))
            if (there := scenario.other_car) is not None:
                other = cls.prepare(scenario.of_other_car, device)
                plant = world_plant(simulation.plant, "other_car")
                simulation = replace(simulation, plant=meet(plant, other, Motion.standing(there.x_m, there.y_m, there.yaw_deg)))
        cache.end()
        return simulation

    @property
    def truth(self) -> World | None:
        """The true world, None if the plant does not know it."""
        return getattr(self.plant, "truth", None)

    @property
    def world(self) -> World:
        """The true world. Raises LuxloopError if the plant does not know it."""
        if (truth := self.truth) is None:
            raise LuxloopError(f"{self.scenario.name}: the plant {self.scenario.plant.kind} does not know the truth; take another plant")
        return truth

    @property
    def symbol(self) -> ControlledSymbol:
        """The only closed-loop symbol. Raises LuxloopError if there are several or none."""
        return self.controlled[only(self.controlled)]

    def lights_of(self, result: StepResult, drawn: Parts) -> Lights:
        """Utilisations of a step with other primitives. drawn: primitives by function."""
        return self.lamps.drive(self.planner.compose(result.now, result.planning.functions, drawn), result.now)[0]

    def of_all(self, symbol: ControlledSymbol, light: Sequence[Utilisation]) -> Lights:
        """Utilisations of all modules, minus their base beams. light: utilisations of the symbol's modules."""
        drawn = dict(zip(symbol.drawn_by, zip(light, symbol.projector.resting, strict=True), strict=True))
        added = {k: Utilisation(each.u - beam.u, each.band) for k, (each, beam) in drawn.items()}
        return tuple(added.get(k, Utilisation(0 * module.flux, slice(0, 0))) for k, module in enumerate(self.modules))

    def with_controller(self, controller: SymbolController) -> "Simulation":
        """The simulation with another controller for its only closed-loop symbol. Raises as `symbol`."""
        return replace(self, controlled={only(self.controlled): replace(self.symbol, controller=controller)})

    @property
    def renderer(self) -> str:
        """Name of the true world's G-buffer source, else kind of the plant."""
        return self.scenario.plant.kind if self.truth is None else self.truth.source.name

    def lit_by(self, light: Baseline) -> "Simulation":
        """The same world and noise in a baseline light: symbols in open loop, or the full or low beam alone.

        Raises LuxloopError for a missing beam or a plant other than the simulated world.
        """
        plant = world_plant(self.plant, f"checks: compare = {light!r}")
        if light == "open_loop":
            return replace(self, controlled={name: each.in_open_loop() for name, each in self.controlled.items()})
        beam = BEAMS[light]
        with locate(f"checks: compare = {light!r}"):
            modules = tuple(module.showing(beam) for module in self.modules)
        alone = self.scenario.lighting.model_copy(update={"base": BaseBeamParams(beam=beam), "raw": (), "painted": ()})
        scenario = self.scenario.model_copy(update={"lighting": alone, "functions": {}})
        plant = replace(plant, shares=scenario.shares, drawings=scenario.drawings[0])
        return replace(self, scenario=scenario, planner=Planner.prepare({}, alone), modules=modules, plant=plant, controlled={})

    @cached_property
    def lamps(self) -> LampDriver:
        """The modules and their power limits."""
        return LampDriver(self.scenario, self.modules, self.truth)

    @cached_property
    def evaluator(self) -> Evaluator:
        """Computes the metrics of steps."""
        return Evaluator(self.scenario, self.planner, self.pipeline, self.controlled, self.lamps, self.truth)

    @property
    def recorded_ids(self) -> Mapping[str, int]:
        """Ids of the recorded objects by name."""
        return self.evaluator.recorded_ids

    def situation(self, time_s: float, tracks: Any = None, ego: Ego | None = None, told: Objects | None = None) -> Situation:
        """Situation at a time, with objects from the detector's tracks. Without one, objects come from the plant or a perfect tracker.

        ego: measured motion, None for a standing, level car. told: objects reported by the plant.
        """
        T_ground_body = attitude(ego)
        lights = tuple(
            (name, replace(each, T_world_headlight=T_ground_body.to(each.T_world_headlight) @ each.T_world_headlight))
            for name, each in self.lights
        )
        speed, yaw_rate = (0.0, 0.0) if ego is None or ego.stands else (float(ego.speed_m_s), float(ego.yaw_rate_rad_s))
        conditions = self.scenario.conditions_at(time_s)
        return Situation(
            time_s,
            torch.eye(4, dtype=torch.float64),
            torch.stack([light.T_world_headlight[:3, 3].double().cpu() for _, light in lights]),
            self._all_objects(time_s, told)
            if self.pipeline is None
            else self._objects_of_tracks(tracks, time_s, self._from(T_ground_body)),
            speed,
            yaw_rate / speed if speed else 0.0,
            conditions.wet,
            conditions.street_lit,
            lights=lights,
            pitch_rad=-math.asin(float(T_ground_body[2, 0])),
            indicator=self.scenario.lighting.indicator,
            rate_hz=self.scenario.rate_hz,
            seed=self.scenario.seed,
        )

    def start(self, step: int = 0) -> SimulationState:
        """The state before a step, without earlier frames."""
        (plant, arrivals), tracks = self.plant.start(), None if self.pipeline is None else self.pipeline.tracker.start()
        arrivals = self.sensor_arrivals(step / self.scenario.rate_hz) if step else arrivals
        symbols = {name: each.start() for name, each in self.controlled.items()}
        gains = None if self.gain_loop is None else self.gain_loop.start()
        return SimulationState(step, tracks, self.planner.start(), plant, arrivals, recent((), arrivals.samples), symbols, gains=gains)

    def sensor_arrivals(self, time_s: float) -> Arrivals:
        """The newest sensor samples for which light of a time is drawn. Raises LuxloopError unless the plant is the simulated world."""
        by_s = max(time_s - self.scenario.headlight.delay_s, 0.0)
        return Arrivals(time_s, samples=world_plant(self.plant, "the light at one time").samples(by_s))

    def ego(self, samples: Samples, time_s: float) -> Ego | None:
        """Estimated motion of the car at a time, None without wheel speeds."""
        return ego_of(samples, self.scenario.vehicle, time_s, self.scenario.frame_shares[0] / self.scenario.rate_hz)

    def step(self, state: SimulationState) -> tuple[SimulationState, StepResult]:
        """One step: sense, plan, drive, expose, control.

        With closed-loop symbols, the first exposure shows all light. The other exposures omit the symbols measured in this step.
        """
        check_process()
        clock = Clock()
        sense = self._sense(state)
        planning = self._plan(state, sense)
        clock.lap("plan")
        drives = self._drive(state, planning, sense)
        clock.lap("light")
        reception = self._expose(state, planning, drives, clock)
        clock.lap("plant")
        clock.watch(reception.unpaired)
        perception, control = self._control(state, sense, planning, reception, clock)
        lights = tuple(light.u for light in drives[0].lights)
        timing = clock.ms, clock.processing_ms
        result = StepResult(state.step, sense, planning, lights, reception, perception, control, *timing)
        return self._following(result), result

    def _sense(self, state: SimulationState) -> Sense:
        """Motion, situation and module commands from the arrivals so far.

        Raises LuxloopError if a user's function moves or dims a module that draws a closed-loop symbol.
        """
        time_s = state.arrivals.time_s
        by_s = max(time_s - self.scenario.headlight.delay_s, 0.0) + SAME_S
        ego = self.ego(tuple(each for each in state.samples if each.arrived_s <= by_s), time_s)
        now = self.situation(time_s, state.tracks, ego, state.arrivals.objects)
        commanded = self.planner.command(state.commanded, now, self.modules)
        if commanded:
            now = now.under(commands := compose(commanded.values(), self.modules))
            for symbol, held in self.controlled.items():
                if turned := [self.modules[k].name for k in held.drawn_by if commands[k] != REST]:
                    raise LuxloopError(at_rest(symbol, turned[0], "turned or dimmed"))
        return Sense(ego, now, self._from(attitude(ego)), commanded)

    def _plan(self, state: SimulationState, sense: Sense) -> StepPlan:
        """Light plans from functions and controllers: with all symbols, and without the symbols measured in this step."""
        projections, drawn = self._primitives(state, sense)
        measured = choose_measured(self.controlled, state.symbols, projections)
        plans = [self.planner.compose(sense.now, state.functions, drawn)]
        if measured:
            plans.append(self.planner.compose(sense.now, state.functions, without(drawn, measured)))
        return StepPlan(state.functions, state.symbols, projections, drawn, measured, tuple(plans))

    def _drive(self, state: SimulationState, planning: StepPlan, sense: Sense) -> tuple[Drive, ...]:
        """Lamp drive for the on frame, and for the off frame."""
        (first, *others), now = planning.plans, sense.now
        shown = self.lamps.drive(first, now)
        lights, powers = self.lamps.drive(others[0], now, (first, shown[0])) if others else shown
        left = {name: each for name, each in planning.projections.items() if name not in planning.measured}
        on = self._raw(shown[0], planning.projections)
        if self.gain_loop is not None and state.gains is not None:
            on, lights = self.gain_loop.lights(state.gains, state.step, on)
        return Drive(on, planning.projections, now.commands, shown[1]), Drive(lights, left, now.commands, powers)

    def _redraw(self, state: SimulationState, without_symbols: Collection[str]) -> Drive:
        """Lamp drive by the newest samples."""
        sense = self._sense(state)
        projections, drawn = self._primitives(state, sense, without_symbols)
        lights, powers = self.lamps.drive(self.planner.compose(sense.now, state.functions, drawn), sense.now)
        return Drive(self._raw(lights, projections), projections, sense.now.commands, powers)

    def _expose(self, state: SimulationState, planning: StepPlan, drives: Sequence[Drive], clock: Clock) -> Reception:
        """Show the exposures on the plant and collect arrivals."""
        plant, samples, arrivals, shown, exposures = state.plant, state.samples, [state.arrivals], list[Drive](), list[Exposure]()
        shares, rate_hz, on = self.scenario.shares, self.scenario.rate_hz, self.scenario.drawings[0]
        for part, share in enumerate(shares):
            drive = drives[part >= on]
            if part and self.scenario.headlight.rate_hz is not None:
                clock.lap("plant")
                now = replace(state, arrivals=arrivals[-1], samples=samples)
                drive = self._redraw(now, planning.measured if part >= on else ())
                clock.lap("light")
            number, start_s = len(shares) * state.step + part, arrivals[-1].time_s
            light = drive.lights, drive.projections, drive.commands
            exposures.append(Exposure(number, start_s, share / rate_hz, *light, frame=part in (0, on)))
            shown.append(drive)
            plant, come = self.plant.show(plant, exposures[-1])
            arrivals.append(come)
            samples = recent(samples, come.samples)
        frames = tuple(frame for each in arrivals[1:] for frame in each.frames)
        powers = mean_powers([each.powers for each in shown], shares)
        return Reception(plant, samples, tuple(exposures), tuple(arrivals), powers, frames, state.unpaired + frames)

    def _control(
        self, state: SimulationState, sense: Sense, planning: StepPlan, reception: Reception, clock: Clock
    ) -> tuple[Perception, Control]:
        """Perception and symbol control from the arrived frames."""
        perception = self._perceive(state, sense, reception)
        clock.lap("find")
        control = self._measure(state, sense, planning, reception)
        clock.lap("control")
        return perception, control

    def _perceive(self, state: SimulationState, sense: Sense, reception: Reception) -> Perception:
        """Run detector, tracker and learning functions on the arrived frames."""
        per_step = len(self.scenario.shares)
        taken = (0, *self.scenario.drawings[:-1])
        watched = {"on": taken[:1], "off": taken[-1:], "both": taken}[self.scenario.detector_frames]
        if state.step % self.scenario.detector_every:
            watched = ()
        views = {**state.views, **{per_step * state.step + part: sense.view for part in watched}}
        known = Perception(state.tracks, state.functions, None, None, sense.now.time_s, views)
        for frame in reception.frames:
            if (view := known.views.get(frame.number)) is not None:
                # Frames arrive in order: earlier ones are lost.
                known = replace(known, views={number: each for number, each in known.views.items() if number > frame.number})
                if frame.image is not None:
                    known = self._look(known, frame.image, frame.taken_s, view, sense.now)
        return known

    def _look(self, known: Perception, image: Tensor, taken_s: float, view: View, now: Situation) -> Perception:
        """Perception after one frame. image: digital numbers `[height, width]`. view: estimated camera view at taken_s."""
        reads = self.planner.learns or self.pipeline is not None
        image, world, tracks, found, functions = image[:, :] if reads else image, self.truth, known.tracks, known.found, known.functions
        then = world.lit(taken_s) if reads and world is not None else None
        if self.pipeline is not None:
            share = image / (2**self.scenario.camera.bits - 1)
            found = self.pipeline.find(share, then)
            tracks = self.pipeline.tracker.follow(tracks, found, share, taken_s)
        if self.planner.learns:
            functions = self.planner.step(functions, self._learnt(now, then, taken_s, image, view, tracks))
        return replace(known, tracks=tracks, functions=functions, found=found, image=image, taken_s=taken_s)

    def _measure(self, state: SimulationState, sense: Sense, planning: StepPlan, reception: Reception) -> Control:
        """Measure the arrived frame pairs and step the symbol controllers."""
        alone = len(planning.projections) == 1 and len(self.planner.functions) == 1 and self.scenario.lighting.power_limit is None
        framed = [each for each in reception.exposures if each.frame]
        shown = ExposurePair(framed[0], framed[-1], sense.ego, alone)
        pairs, awaiting, unpaired = (
            pair_frames((*state.awaiting, shown), reception.unpaired) if self.controlled or self.gain_loop else ([], (), ())
        )
        newer = self.ego(reception.samples, reception.arrivals[-1].time_s)
        gains = state.gains
        symbols = {name: replace(each, turn=state.step) if name in planning.measured else each for name, each in state.symbols.items()}
        seen = dict[str, Measurement]()
        for pair in pairs:
            latency = state.step - pair.on.number // len(self.scenario.shares)
            if self.gain_loop is not None and gains is not None:
                egos = [self.ego(reception.samples, each.start_s) for each in (pair.on, pair.off)]
                gains = self.gain_loop.step(gains, pair, egos)
            for name in (name for name in symbols if name in pair.on.projections):
                symbols[name], seen[name] = self.controlled[name].step(symbols[name], name, pair, newer, latency)
        measurements = {
            name: seen[name] if name in seen else self.controlled[name].sensor.lost(projection.pose, ExtractionStatus.NO_FRAME)
            for name, projection in planning.projections.items()
        }
        frames, taken_s = (pairs[-1].images, pairs[-1].taken_s) if pairs else (None, math.nan)
        return Control(symbols, measurements, awaiting, unpaired, frames, taken_s, gains)

    def _following(self, result: StepResult) -> SimulationState:
        """The state before the next step."""
        perception, reception, control = result.perception, result.reception, result.control
        return SimulationState(
            step=result.step + 1,
            tracks=perception.tracks,
            functions=perception.functions,
            plant=reception.plant,
            arrivals=reception.arrivals[-1],
            samples=reception.samples,
            symbols=control.symbols,
            views=perception.views,
            awaiting=control.awaiting,
            unpaired=control.unpaired,
            commanded=result.sense.commands,
            gains=control.gains,
        )

    def _raw(self, lights: Lights, projections: Mapping[str, ProjectionCommand]) -> Lights:
        """Insert utilisations from controllers that drive pixels directly. Raises LuxloopError if there are other functions."""
        shown = list(lights)
        for name, projection in projections.items():
            if projection.raw is not None:
                if len(self.planner.functions) > 1:
                    raise LuxloopError(f"functions.{name}.controller: drives all pixels, which leaves none to others; take them out")
                for k, u in zip(self.controlled[name].drawn_by, projection.raw, strict=True):
                    shown[k] = self.planner.paint(self.modules[k].name, Utilisation(u))
        return tuple(shown)

    def _primitives(
        self, state: SimulationState, sense: Sense, without_symbols: Collection[str] = ()
    ) -> tuple[dict[str, ProjectionCommand], Parts]:
        """Projection commands of the symbols shown now, and primitives of all functions."""
        now, ego = sense.now, sense.ego
        shown = {name: each for name, each in self.controlled.items() if name not in without_symbols and each.function.shows(now)}
        projections = {name: each.controller.projection(state.symbols[name].controller, ego) for name, each in shown.items()}
        commands = {}
        for name, projection in projections.items():
            with locate(f"functions.{name}"):
                commands[name] = shown[name].command(projection, None if ego is None else attitude(ego))
        return projections, self.planner.draw(now, state.functions) | commands

    def at(self, step: int) -> Evaluation:
        """One step evaluated without its predecessors; equal to the run's step unless the simulation `remembers`."""
        return self.evaluate(self.step(self.start(step))[1])

    def lights_at(self, time_s: float) -> tuple[tuple[Tensor, ...], Commands]:
        """Utilisations `[n_p]`, one a module, and module commands at any time, after the earlier steps if the simulation `remembers`."""
        state = self.start()
        while self.remembers and (state.step + 1) / self.scenario.rate_hz <= time_s:
            state, _ = self.step(state)
        arrivals = replace(self.sensor_arrivals(time_s), objects=state.arrivals.objects)
        state = replace(state, arrivals=arrivals, samples=recent((), arrivals.samples))
        sense = self._sense(state)
        lights, _ = self.lamps.drive(self._plan(state, sense).plans[0], sense.now)
        return tuple(light.u for light in lights), sense.now.commands

    @property
    def remembers(self) -> bool:
        """Whether a step depends on earlier steps."""
        loops = self.controlled or self.planner.commanding or self.gain_loop or self.scenario.other_car
        return self.pipeline is not None or self.planner.learns or bool(loops)

    def base(self, beam: str) -> str:
        """The light below all functions in words. beam: name of the base beam."""
        raw = [module.raw is not None for module in self.modules]
        told = "base beam off" if beam == "off" else f"{beam} beam"
        return "raw utilisations" if all(raw) else f"{told} and raw utilisations" if any(raw) else told

    def show(self) -> StudioWindow:
        """Watch and steer the scenario in a notebook, in the page of `luxloop studio`; see `luxloop.show`."""
        return StudioWindow(self.scenario, str(self.device))

    def run(self) -> Generator[StepResult, None, None]:
        """Run all steps of the scenario, then close the plant."""
        with ExitStack() as stack:
            stack.callback(close_plant, self.plant)
            state = self.start()
            for _ in range(self.scenario.steps):
                with locate(self.scenario.source):
                    state, result = self.step(state)
                yield result

    def evaluate(self, result: StepResult, before: Evaluation | None = None) -> Evaluation:
        """A step with its metrics. before: evaluation of the previous step, None for the first."""
        with locate(self.scenario.source):
            return self.evaluator.evaluate(result, before)

    def evaluations(self) -> Generator[Evaluation, None, None]:
        """Run and evaluate all steps of the scenario, then close the plant."""
        before = None
        with closing(self.run()) as steps:
            for result in steps:
                before = self.evaluate(result, before)
                yield before

    def idle(self, result: StepResult) -> set[str]:
        """Names of the functions without effect in a step: they move no module, and none of their primitives is in a lamp's reach."""
        drawn = self.planner.draw(result.now, result.planning.functions)
        reach = {name for name, parts in drawn.items() if any(in_reach(self.modules, part, result.now) for part in parts)}
        given = self.planner.command({}, result.now, self.modules)
        moving = {name for name, each in given.items() if any(command != REST for _, command in each.commands)}
        return drawn.keys() - reach - result.planning.projections.keys() - moving

    def waiting(self, result: StepResult) -> set[str]:
        """Names of the functions waiting for the indicator in a step."""
        return {name for name, each in self.scenario.functions.items() if isinstance(each, ScheduleParams) and each.waits(result.now)}

    def _all_objects(self, time_s: float, known: Objects | None) -> Objects:
        if known is not None or self.truth is None or not self.scenario.all_objects:
            return known or ()
        T_ground_world = inverse(self.world.motion.at(time_s).T_world_ground)
        told = ((body, item.category) for body, item in zip(self.world.scene.objects, self.scenario.all_objects, strict=True))
        found = (TrackedObject.of(body, category, time_s) for body, category in told if category is not None)
        return tuple(replace(each, T_world_object=T_ground_world @ each.T_world_object) for each in found)

    def _objects_of_tracks(self, tracks: Any, time_s: float, view: View) -> Objects:
        return () if self.pipeline is None or tracks is None else self.pipeline.objects(tracks, time_s, view)

    def _from(self, T_ground_body: Tensor) -> View:
        """Estimated camera view in the ground frame. T_ground_body: `[4, 4]`."""
        return replace(self.view, T_world_view=T_ground_body @ self.view.T_world_view)

    def _learnt(self, now: Situation, then: LitScene | None, then_s: float, image: Tensor, view: View, tracks: Any) -> Situation:
        """The situation with a camera image. then_s: exposure time. then: scene at that time. view: estimated camera view."""
        camera = self.scenario.camera
        luminance, most = luminance_of(image, camera), saturation_luminance(camera)
        looks = any(function.kind == "material" for function in self.scenario.functions.values())
        materials = (then.surfaces.albedo, *then.materials) if looks and then is not None else ()
        objects = now.objects if self.pipeline is None else self._objects_of_tracks(tracks, now.time_s, view)
        return replace(now, objects=objects, seen=CameraImage(then_s, view, luminance, most, *materials))
