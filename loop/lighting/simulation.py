"""Lighting functions at work: at each step the objects are tracked, the functions planned, the lamps driven, and the light looked at."""

import math
from collections.abc import Collection, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from controllers.functions.base_beams import BaseBeamParams, BeamName
from controllers.functions.commands import Given
from controllers.functions.planner import Plan, Planner
from controllers.pixels.primitives import Primitives
from controllers.pixels.secondary import Light, SecondaryRays, scene_caster
from controllers.pixels.ssc import Utilisation
from controllers.situation import Seen, Situation, Timed, TrackedObject
from controllers.symbol.sensing.projection import ProjectionCommand
from controllers.symbol.sensing.protocol import SymbolController
from controllers.symbol.sensing.symbol_sensor import Measurement
from loop.assembly.made import Made
from loop.lighting.commanded import commanded
from loop.lighting.controlled import ControlledSymbol, Moment, turn
from loop.lighting.detection import DetectionPipeline, false_positives, recognised
from loop.lighting.ground import attitude, moved, seen_from
from loop.lighting.judging import over_setpoint
from loop.lighting.lamps import LampPower, ShiningModule, asked, driven, in_reach, mean_powers
from loop.lighting.observed import ObservedSymbol, in_white, observed_symbols
from loop.lighting.on_materials import OnMaterial, in_zones, on_materials
from loop.lighting.on_objects import DUE_S, OnObject, light_on_objects, must_be_dark, near_enough, on_eyes, on_objects, told_as
from loop.lighting.parts import parts
from loop.lighting.result import Clock, FrameDetections, SimulationState, StepResult
from loop.plant.pairing import paired
from loop.plant.protocol import Arrivals, Exposure, Objects, Plant, Showing, closed
from loop.plant.simulated import as_simulated
from loop.plant.world import LitScene, ObjectLight, World, categories
from loop.scenario.checks import Light as OtherLight
from loop.scenario.model import Scenario, only
from loop.scenario.shown import Shown
from perception.camera import luminance_of, saturation_luminance
from perception.detection.protocol import Detections
from perception.egomotion import Ego, Samples, ego_of, newest
from perception.judge import Verdict
from world.errors import LuxloopError, located
from world.frames import inverse
from world.headlight.lamp import REST, Commands
from world.process import check_process
from world.scene.scene import StreetLamp
from world.view import View

Lights = tuple[Utilisation, ...]  # of all modules
Parts = Mapping[str, Sequence[Primitives]]  # that functions draw, by name
BEAMS: Mapping[OtherLight, BeamName] = {"full_light": "full", "low_beam": "low"}


@dataclass(frozen=True, eq=False)
class Simulation:
    """A scenario made ready to run on one device.

    Functions live in the ground frame, which drives with the car. view: what the camera of a car on a level body would see, as the car
    believes. pipeline: None without a detector. controlled: symbols that are held, by name. made: the parts. Without detector and held
    symbols steps depend on their time alone, unless a function learns, or commands modules.
    """

    scenario: Scenario
    device: torch.device
    planner: Planner
    modules: tuple[ShiningModule, ...]
    lights: tuple[tuple[str, Light], ...]
    view: View
    plant: Plant
    pipeline: DetectionPipeline | None = None
    controlled: Mapping[str, ControlledSymbol] = field(default_factory=dict)
    made: Made = field(default_factory=Made)

    @classmethod
    def prepare(cls, scenario: Scenario, device: torch.device | str = "cpu", before: "Simulation | None" = None) -> "Simulation":
        """Build scene and lamps, load symbols, plan a step. Raises LuxloopError where something is missing, beams included, or broken.

        before: another simulation, of which all that has stayed as it was serves again.
        """
        device = torch.device(device)
        made = Made(None if before is None or before.device != device else before.made)
        with located(scenario.source):
            simulation = cls(scenario, device, made=made, **parts(scenario, device, made))
            simulation.planner.plan(simulation.situation(0.0))
        made.end()
        return simulation

    @property
    def truth(self) -> World | None:
        """What is true, None where the plant does not know it."""
        return getattr(self.plant, "truth", None)

    @property
    def world(self) -> World:
        """What is true, where it must be known. Raises LuxloopError on a plant that does not know it."""
        if (truth := self.truth) is None:
            raise LuxloopError(f"{self.scenario.name}: the plant {self.scenario.plant.kind} does not know the truth; take another plant")
        return truth

    @property
    def symbol(self) -> ControlledSymbol:
        """The only symbol that a controller holds. Raises LuxloopError where there are several or none."""
        return self.controlled[only(self.controlled)]

    def lights_of(self, result: StepResult, drawn: Parts) -> Lights:
        """Those of a step in which the functions draw these primitives, by name."""
        return self._driven(self.planner.composed(result.now, result.functions, drawn), result.now)[0]

    def of_all(self, symbol: ControlledSymbol, light: Sequence[Utilisation]) -> Lights:
        """What a light of a symbol's modules adds to their base beams, as utilisations of all modules."""
        drawn = dict(zip(symbol.drawn_by, zip(light, symbol.projector.resting, strict=True), strict=True))
        added = {k: Utilisation(each.u - beam.u, each.band) for k, (each, beam) in drawn.items()}
        return tuple(added.get(k, Utilisation(0 * module.flux, slice(0, 0))) for k, module in enumerate(self.modules))

    def with_controller(self, controller: SymbolController) -> "Simulation":
        """The same with another controller of the only symbol that is held. Raises as `symbol`."""
        return replace(self, controlled={only(self.controlled): replace(self.symbol, controller=controller)})

    @property
    def renderer(self) -> str:
        """Source of the simulated plant's G-buffers, else what the plant is called."""
        return self.scenario.plant.kind if self.truth is None else self.truth.source.name

    def lit_by(self, light: OtherLight) -> "Simulation":
        """The same world with the same noise: in open loop, or lit by nothing but a beam, all pixels on or the low beam.

        Raises LuxloopError where there is no such beam, and on a plant that is not the simulated world.
        """
        plant = as_simulated(self.plant, f"checks: compare = {light!r}")
        if light == "open_loop":
            return replace(self, controlled={name: each.in_open_loop() for name, each in self.controlled.items()})
        beam = BEAMS[light]
        with located(f"checks: compare = {light!r}"):
            modules = tuple(module.showing(beam) for module in self.modules)
        alone = self.scenario.lighting.model_copy(update={"base": BaseBeamParams(beam=beam), "raw": (), "painted": ()})
        scenario = self.scenario.model_copy(update={"lighting": alone, "functions": {}})
        plant = replace(plant, shares=scenario.shares)
        return replace(self, scenario=scenario, planner=Planner.prepare({}, alone), modules=modules, plant=plant, controlled={})

    @cached_property
    def watched(self) -> Mapping[str, int]:
        """Objects that are recorded, by name, and their ids: those that a tracker is told of, with a detector all that it ought to find."""
        if self.truth is None:
            return {}
        told = [item.category for item in self.scenario.all_objects]
        wanted = enumerate(zip(self.world.scene.objects, told if self.pipeline is None else categories(self.world.given), strict=True), 1)
        return {body.name: number for number, (body, category) in wanted if category is not None}

    def situation(self, time_s: float, tracks: Any = None, ego: Ego | None = None, told: Objects | None = None) -> Situation:
        """What the car knows at a time: from tracks, if there is a detector, else as told by the plant, or by a tracker without mistakes.

        ego: its motion as measured; left out: it stands on a level body.
        """
        T_ground_body = attitude(ego)
        lights = tuple((name, replace(each, T_world_headlight=moved(T_ground_body, each.T_world_headlight))) for name, each in self.lights)
        speed, yaw_rate = (0.0, 0.0) if ego is None or ego.stands else (float(ego.speed_m_s), float(ego.yaw_rate_rad_s))
        conditions = self.scenario.conditions_at(time_s)
        return Situation(
            time_s,
            torch.eye(4, dtype=torch.float64),
            torch.stack([light.T_world_headlight[:3, 3].double().cpu() for _, light in lights]),
            self._all_objects(time_s, told) if self.pipeline is None else self._tracked(tracks, time_s, T_ground_body),
            speed,
            yaw_rate / speed if speed else 0.0,
            conditions.wet,
            conditions.street_lit,
            lights=lights,
            pitch_rad=-math.asin(float(T_ground_body[2, 0])),
            indicator=self.scenario.lighting.indicator,
        )

    def _commanded(self, time_s: float, state: SimulationState, ego: Ego | None) -> tuple[Situation, Mapping[str, Given]]:
        now = self.situation(time_s, state.tracks, ego, state.arrivals.objects)
        return commanded(self.planner, self.modules, self.controlled, state.commanded, now)

    def start(self, step: int = 0) -> SimulationState:
        """The state before a step, with nothing seen yet."""
        (plant, arrivals), tracks = self.plant.start(), None if self.pipeline is None else self.pipeline.tracker.start()
        arrivals = self.sensed(step / self.scenario.rate_hz) if step else arrivals
        held = {name: each.start() for name, each in self.controlled.items()}
        return SimulationState(step, tracks, self.planner.start(), plant, arrivals, newest({}, arrivals.samples), held)

    def sensed(self, time_s: float) -> Arrivals:
        """What the sensors have told by a time. Raises LuxloopError on a plant that is not the simulated world."""
        return Arrivals(time_s, samples=as_simulated(self.plant, "the light at one time").samples(time_s))

    def ego(self, samples: Samples, time_s: float) -> Ego | None:
        """What is known of the car's motion at a time, None of one that stands."""
        return ego_of(samples, self.scenario.vehicle, time_s, self.scenario.shares[0] / self.scenario.rate_hz)

    def step(self, state: SimulationState) -> tuple[SimulationState, StepResult]:
        """One step: light is planned with what is known, and what is then seen adds to it.

        Where symbols are held all light is shown first, and for the rest of the step all but the symbols whose turn it is.
        """
        check_process()
        clock, time_s, shares, world = Clock(), state.arrivals.time_s, self.scenario.shares, self.truth
        per_step = len(shares)
        ego = self.ego(state.samples, time_s)
        view, (now, given) = self._from(attitude(ego)), self._commanded(time_s, state, ego)
        projections, drawn = self._drawn(state, now, ego)
        measured = turn(self.controlled, state.held, projections)
        plans = [self.planner.composed(now, state.functions, drawn)]
        if measured:
            plans.append(self.planner.composed(now, state.functions, _without(drawn, measured)))
        clock.lap("plan")
        driven = [self._driven(plans[0], now)]
        driven += [self._driven(plan, now, (plans[0], driven[0][0])) for plan in plans[1:]]
        plan, exposures = plans[0], [lights for lights, _ in driven] * (per_step // len(driven))
        exposures[0] = self._raw(exposures[0], projections)
        wanted = [projections, *[{name: each for name, each in projections.items() if name not in measured}] * (per_step - 1)]
        clock.lap("light")
        plant, arrivals, samples, frames, showings = state.plant, state.arrivals, state.samples, state.frames, list[Showing]()
        for part, (share, shown, projection) in enumerate(zip(shares, exposures, wanted, strict=True)):
            number, duration_s = per_step * state.step + part, share / self.scenario.rate_hz
            before, exposure = arrivals, Exposure(number, arrivals.time_s, duration_s, shown, projection, now.commands)
            plant, arrivals = self.plant.show(plant, exposure)
            showings.append(Showing(before, exposure, arrivals))
            frames, samples = frames + arrivals.frames, newest(samples, arrivals.samples)
        clock.lap("plant")
        watched = {"on": (0,), "off": (per_step - 1,), "both": range(per_step)}[self.scenario.detector_frames]
        believed = {**state.believed, **{per_step * state.step + part: view for part in watched}}
        tracks, functions, image, found, then_s = state.tracks, state.functions, None, None, time_s
        for frame in frames[len(state.frames) :]:
            if (then_view := believed.get(frame.number)) is None:
                continue
            believed = {number: each for number, each in believed.items() if number > frame.number}  # those before it never come
            if frame.image is not None:
                reads = self.planner.learns or self.pipeline is not None
                image, then_s = frame.image[:, :] if reads else frame.image, frame.taken_s
                then = world.lit(then_s) if reads and world is not None else None
                if self.pipeline is not None:
                    found = self.pipeline.find(share := image / (2**self.scenario.camera.bits - 1), then)
                    tracks = self.pipeline.tracker.follow(tracks, found, share, then_s)
                if self.planner.learns:
                    functions = self.planner.step(functions, self._learnt(now, then, then_s, image, then_view, tracks))
        clock.lap("find")
        oncoming_s = near_enough(world.lit(time_s), state.oncoming_s, time_s) if self.pipeline and world and world.metered else {}
        metered = [] if world is None else light_on_objects(world, showings)
        due = [name for name, since_s in oncoming_s.items() if time_s - since_s >= DUE_S]
        detected = None if self.pipeline is None else self._look(self.pipeline, tracks, found, then_s, metered, due)
        clock.lap("look")
        alone = len(projections) == 1 and len(self.planner.functions) == 1 and self.scenario.lighting.power_limit is None
        moment = Moment(projections, measured, exposures[0], exposures[-1], ego, alone)
        looks, under_way, frames = paired((*state.under_way, (per_step * state.step, moment)), frames) if self.controlled else ([], (), ())
        newer = self.ego(samples, arrivals.time_s)
        held = {name: replace(each, turn=state.step) if name in measured else each for name, each in state.held.items()}
        looked = dict[str, Measurement]()
        for each in looks:
            moment = each.what.as_shown(each)
            for name in (name for name in held if name in moment.projections):
                held[name], looked[name] = self.controlled[name].step(held[name], name, moment, each.images, newer)
        clock.lap("control")
        masked = frozenset(each.name for each in now.objects if must_be_dark(self.scenario.functions, each, now))
        told = told_as(self.watched, None if detected is None else detected.recognised)
        luminance = None if world is None else world.image(time_s, exposures[0], now.commands)
        illuminance = world.illuminance_image(time_s, exposures[0], now.commands) if world is not None and metered else None
        zones = in_zones(self.planner.functions, state.functions, luminance, view if world is None else world.view_from_ground(time_s))
        objects: Mapping[str, OnObject] = {}
        materials: Mapping[str, OnMaterial] = {}
        symbols: tuple[ObservedSymbol, ...] = ()
        verdicts: Mapping[str, Verdict] = {}
        if world is not None and illuminance is not None and luminance is not None:
            objects = on_objects(self.watched, frozenset(told[name] for name in masked & told.keys()), metered, shares)
            materials = on_materials(self.planner.functions, functions, now, told, world, illuminance, luminance)
            if (white := in_white(plan)) is not None:
                whitened = [light.u for light in self._driven(white, now)[0]]
                symbols = observed_symbols(plan, [light.u for light in exposures[0]], whitened, world, now)
        judges = world is not None and bool(every := self.scenario.judge_every) and state.step % every == 0
        compares = judges and metered and self.pipeline is not None and self.planner.functions
        road_ratio = over_setpoint(self._turned(now), plan, exposures[0], self.world.lit(time_s)) if compares else None
        if judges and measured:
            verdicts = self._judged(state, now, drawn, measured, exposures)
        results = {name: self.controlled[name].held(each, looked.get(name), verdicts.get(name)) for name, each in projections.items()}
        clock.lap("look")
        result = StepResult(
            state.step,
            time_s,
            now,
            view,
            state.functions,
            masked,
            plan,
            tuple(light.u for light in exposures[0]),
            mean_powers([powers for _, powers in driven], shares),
            illuminance,
            luminance,
            image,
            looks[-1].images if looks else None,
            looks[-1].taken_s if looks else math.nan,
            objects,
            detected,
            symbols,
            results,
            zones,
            materials,
            road_ratio,
            tuple(showings),
            clock.taken_ms,
            clock.processing_ms,
        )
        known = tracks, functions, plant, arrivals, samples, held, believed, under_way, frames, given, oncoming_s
        return SimulationState(state.step + 1, *known), result

    def _judged(
        self, state: SimulationState, now: Situation, drawn: Parts, measured: Sequence[str], exposures: Sequence[Lights]
    ) -> Mapping[str, Verdict]:
        """Of each symbol that is measured. exposures: the light with all of them, and without."""
        verdicts, (on, off) = {}, exposures
        for name in measured:
            if len(measured) > 1:
                off, _ = self._driven(self.planner.composed(now, state.functions, _without(drawn, [name])), now)
            judge = self.controlled[name].judge
            assert judge is not None
            verdicts[name] = judge.judged(self.world.added(now.time_s, on, off, now.commands), now.time_s)
        return verdicts

    def _raw(self, lights: Lights, projections: Mapping[str, ProjectionCommand]) -> Lights:
        """With the utilisations that a controller gives in place of a symbol. Raises LuxloopError beside other functions."""
        shown = list(lights)
        for name, projection in projections.items():
            if projection.raw is not None:
                if len(self.planner.functions) > 1:
                    raise LuxloopError(f"functions.{name}.controller: drives all pixels, which leaves none to others; take them out")
                for k, u in zip(self.controlled[name].drawn_by, projection.raw, strict=True):
                    shown[k] = self.planner.paint(self.modules[k].name, Utilisation(u))
        return tuple(shown)

    def _drawn(self, state: SimulationState, now: Situation, ego: Ego | None) -> tuple[dict[str, ProjectionCommand], Parts]:
        """What controllers want drawn of the symbols that are shown now, and the primitives of all functions."""
        shown = {name: each for name, each in self.controlled.items() if each.function.shows(now)}
        projections = {name: each.controller.projection(state.held[name].controller, ego) for name, each in shown.items()}
        commands = {}
        for name, projection in projections.items():
            with located(f"functions.{name}"):
                commands[name] = shown[name].command(projection, None if ego is None else attitude(ego))
        return projections, self.planner.drawn(now, state.functions) | commands

    def at(self, step: int) -> StepResult:
        """One step alone, before which nothing was seen; that of the run where nothing depends on what was seen."""
        return self.step(self.start(step))[1]

    def lights_at(self, time_s: float) -> tuple[tuple[Tensor, ...], Commands]:
        """Utilisations `[n_p]`, one a module, and commands at any time; what depends on steps before is run up to it."""
        state = self.start()
        while self.remembers and (state.step + 1) / self.scenario.rate_hz <= time_s:
            state, _ = self.step(state)
        ego = self.ego(newest({}, self.sensed(time_s).samples), time_s)
        now, _ = self._commanded(time_s, state, ego)
        lights, _ = self._driven(self.planner.composed(now, state.functions, self._drawn(state, now, ego)[1]), now)
        return tuple(light.u for light in lights), now.commands

    @property
    def remembers(self) -> bool:
        """Whether a step depends on those before it."""
        return self.pipeline is not None or self.planner.learns or bool(self.controlled) or bool(self.planner.commanding)

    def base(self, beam: str) -> str:
        """What shines below all functions, in words, where the base beam is one of this name."""
        raw = [module.raw is not None for module in self.modules]
        told = "base beam off" if beam == "off" else f"{beam} beam"
        return "raw utilisations" if all(raw) else f"{told} and raw utilisations" if any(raw) else told

    def show(self) -> Shown:
        """Watch and steer the scenario in the page of `luxloop studio`, in a frame of a notebook; as `luxloop.show`, which says more."""
        return Shown(self.scenario, str(self.device))

    def run(self) -> Generator[StepResult, None, None]:
        """All steps of the scenario, after which the plant is closed."""
        with closed(self.plant):
            state = self.start()
            for _ in range(self.scenario.steps):
                with located(self.scenario.source):
                    state, result = self.step(state)
                yield result

    def idle(self, result: StepResult) -> set[str]:
        """Names of the functions that move no module at that moment, and of which no ray of any lamp that draws them hits anything."""
        drawn = self.planner.drawn(result.now, result.functions)
        reach = {name for name, parts in drawn.items() if any(in_reach(self.modules, part, result.now) for part in parts)}
        given = self.planner.commanded({}, result.now, self.modules)
        moving = {name for name, each in given.items() if any(command != REST for _, command in each.commands)}
        return drawn.keys() - reach - result.held.keys() - moving

    def waiting(self, result: StepResult) -> set[str]:
        """Names of the functions that wait for the indicator at that moment."""
        return {name for name, each in self.scenario.functions.items() if isinstance(each, Timed) and each.waits(result.now)}

    def _all_objects(self, time_s: float, known: Objects | None) -> Objects:
        if known is not None or self.truth is None or not self.scenario.all_objects:
            return known or ()
        T_ground_world = inverse(self.world.motion.at(time_s).T_world_ground)
        told = ((body, item.category) for body, item in zip(self.world.scene.objects, self.scenario.all_objects, strict=True))
        found = (TrackedObject.of(body, category, time_s) for body, category in told if category is not None)
        return tuple(replace(each, T_world_object=T_ground_world @ each.T_world_object) for each in found)

    def _tracked(self, tracks: Any, time_s: float, T_ground_body: Tensor) -> Objects:
        return () if self.pipeline is None or tracks is None else self.pipeline.objects(tracks, time_s, self._from(T_ground_body))

    def _from(self, T_ground_body: Tensor) -> View:
        """The camera's view from the ground frame, as the car believes."""
        return replace(self.view, T_world_view=T_ground_body @ self.view.T_world_view)

    def _look(
        self, pipeline: DetectionPipeline, tracks: Any, found: Detections | None, then_s: float, metered: list[ObjectLight], due: list[str]
    ) -> FrameDetections:
        """Of a time. found: in its frame, None without one. metered: in each exposure of now. due: who must not be dazzled any more."""
        found = found or Detections(torch.zeros(0, 4), torch.zeros(0, len(pipeline.classes)))
        present = pipeline.present(tracks, then_s)
        if not metered:
            return FrameDetections(found, present, {}, None, None, None, None)
        then, shares = self.world.lit(then_s), self.scenario.shares
        false = false_positives(then, found, self.scenario.tracker.start_score)
        eyes = on_eyes(self.world.given, due, metered, shares)
        return FrameDetections(found, present, recognised(then, present, found, pipeline.classes), false, *eyes)

    def _learnt(self, now: Situation, then: LitScene | None, then_s: float, image: Tensor, view: View, tracks: Any) -> Situation:
        """The situation once a frame is there, which was taken at then_s of the scene then, in a view that the car believes."""
        camera = self.scenario.camera
        luminance, most = luminance_of(image, camera), saturation_luminance(camera)
        looks = any(function.kind == "material" for function in self.scenario.functions.values())
        materials = (then.surfaces.albedo, *then.materials) if looks and then is not None else ()
        objects = now.objects if self.pipeline is None or tracks is None else self.pipeline.objects(tracks, now.time_s, view)
        return replace(now, objects=objects, seen=Seen(then_s, view, luminance, most, *materials))

    def _turned(self, now: Situation) -> list[ShiningModule]:
        """The modules as they are aimed by what is known of the body, and commanded."""
        return [
            replace(module, T_world_module=light.T_world_headlight, intensity=light.intensity)
            for module, (_, light) in zip(self.modules, now.lights, strict=True)
        ]

    def _driven(self, plan: Plan, now: Situation, more: tuple[Plan, Lights] | None = None) -> tuple[Lights, Mapping[str, LampPower]]:
        """more: a plan that draws all this one does and maybe more, and its light."""
        params, modules, occluded = self.scenario.lighting, self._turned(now), None
        street_lamps: tuple[StreetLamp, ...] = ()
        if params.street_lamps or params.shadow_rays:
            T_world_ground = self.world.motion.at(now.time_s).T_world_ground
            street_lamps = tuple(seen_from(T_world_ground, lamp) for lamp in self.world.scene.street_lamps) if params.street_lamps else ()
            occluded = scene_caster(self.world.lit(now.time_s).triangles, T_world_ground) if params.shadow_rays else None
        secondary = [SecondaryRays(now.lights, own, street_lamps, occluded) for own in range(len(self.modules))]
        lights = asked(modules, plan, secondary, more if params.power_limit is None else None)
        return driven(modules, lights, params.power_limit, self.scenario.headlight.power_w)


def _without(drawn: Parts, names: Collection[str]) -> dict[str, Sequence[Primitives]]:
    return {name: each for name, each in drawn.items() if name not in names}
