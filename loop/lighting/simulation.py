"""Lighting functions at work: at each step the objects are tracked, the functions planned, the lamps driven, and the light looked at."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from controllers.functions.base_beams import BaseBeamParams, BeamName
from controllers.functions.glare_free import GlareFreeParams
from controllers.functions.planner import Plan, Planner
from controllers.pixels.primitives import Primitives
from controllers.pixels.rthc import masks
from controllers.pixels.secondary import Light, SecondaryRays, scene_caster
from controllers.pixels.ssc import Utilisation
from controllers.pixels.windows import projected_windows
from controllers.situation import Seen, Situation, TrackedObject
from loop.assembly.build import build_scene
from loop.assembly.truth import as_it_is, true_camera
from loop.lighting.lamps import LampPower, ShiningModule, driven, shining_modules
from loop.lighting.names import check_names
from loop.lighting.observed import in_white, observed_symbols
from loop.lighting.on_materials import on_materials
from loop.lighting.on_objects import on_objects, told_as
from loop.lighting.result import LightingResult, LightingState, Look
from loop.lighting.sight import Sight, false_positives, recognised
from loop.lighting.view import Filmed, LitScene, Looker, categories
from loop.lighting.zoned import in_zones
from loop.plant.protocol import Exposure
from loop.plant.simulated import SimulatedPlant
from loop.scenario.checks import Light as OtherLight
from loop.scenario.model import DrivingParams, LightingScenario
from loop.scenario.shipped import named
from perception.camera import camera_view, luminance_of, saturation_luminance
from perception.detection.protocol import Detections
from world.errors import located
from world.rendering.face_source import face_source
from world.scene.scene import Scene
from world.view import View

BEAMS: Mapping[OtherLight, BeamName] = {"full_light": "full", "low_beam": "low"}


@dataclass(frozen=True, eq=False)
class LightingSimulation:
    """A lighting scenario made ready to run on one device.

    camera: what it truly sees. view: what the car believes that it sees. sight: None without a detector; then steps depend on their time
    alone, unless a function learns.
    """

    scenario: LightingScenario
    device: torch.device
    planner: Planner
    scene: Scene
    modules: tuple[ShiningModule, ...]
    lights: tuple[tuple[str, Light], ...]
    camera: Looker
    view: View
    plant: SimulatedPlant[Filmed]
    sight: Sight | None = None

    @classmethod
    def prepare(cls, scenario: LightingScenario, device: torch.device | str = "cpu") -> "LightingSimulation":
        """Build scene and lamps, load symbols, plan a step. Raises LuxloopError where something is missing, beams included, or broken."""
        with located(scenario.source):
            return cls._prepare(scenario, torch.device(device))

    @classmethod
    def _prepare(cls, scenario: LightingScenario, device: torch.device) -> "LightingSimulation":
        planner = Planner.prepare(scenario.functions, scenario.lighting, lambda image: named(image, "symbols"))
        scene = build_scene(scenario)
        modules = shining_modules(scenario, device)
        check_names(scenario, modules)
        believed, true = camera_view(scenario.camera), true_camera(scenario)
        camera = Looker(
            scene, camera_view(true), _as_they_are(scenario, modules), scenario.all_objects, face_source(scenario.renderer), device
        )
        plant = SimulatedPlant(Filmed(camera, true), scenario.rate_hz, scenario.seed, disturbances=scenario.disturbances, per_step=1)
        lights = tuple((module.name, Light.of(module.headlight, module.T_world_module)) for module in modules)
        given = scenario.detector
        sight = None if given is None else Sight.prepare(given, scenario.tracker, believed, device)
        simulation = cls(scenario, device, planner, scene, modules, lights, camera, believed, plant, sight)
        planner.plan(simulation.situation(0.0))
        return simulation

    def lit_by(self, light: OtherLight) -> "LightingSimulation":
        """The same world with the same noise, lit by nothing but a beam: all pixels on, or the low beam. Raises LuxloopError without it."""
        beam = BEAMS[light]
        with located(f"checks: compare = {light!r}"):
            modules = tuple(module.showing(beam) for module in self.modules)
        alone = self.scenario.lighting.model_copy(update={"base": BaseBeamParams(beam=beam), "raw": ()})
        scenario = self.scenario.model_copy(update={"lighting": alone, "functions": {}})
        return replace(self, scenario=scenario, planner=Planner.prepare({}, alone), modules=modules)

    @cached_property
    def watched(self) -> Mapping[str, int]:
        """Objects that are recorded, by name, and their ids: those that a tracker is told of, with a detector all that it ought to find."""
        told = [item.category for item in self.scenario.all_objects]
        wanted = enumerate(zip(self.scene.objects, told if self.sight is None else categories(self.camera.given), strict=True), 1)
        return {body.name: number for number, (body, category) in wanted if category is not None}

    def situation(self, time_s: float, tracks: Any = None) -> Situation:
        """What the car knows at a time: from tracks, if there is a detector, else from a tracker that makes no mistakes."""
        drive = driving(self.scenario.driving, time_s)
        return Situation(
            time_s,
            torch.eye(4, dtype=torch.float64),
            torch.stack([module.T_world_module[:3, 3].double().cpu() for module in self.modules]),
            self._all_objects(time_s) if self.sight is None else () if tracks is None else self.sight.objects(tracks, time_s),
            drive.speed_m_s,
            drive.curvature_1_m,
            drive.wet,
            drive.street_lit,
            lights=self.lights,
        )

    def start(self, step: int = 0) -> LightingState:
        """The state before a step, with nothing seen yet."""
        plant, _ = self.plant.start()
        return LightingState(step, None if self.sight is None else self.sight.tracker.start(), self.planner.start(), plant)

    def step(self, state: LightingState) -> tuple[LightingState, LightingResult]:
        """One step: light is planned with what is known, and what is then seen adds to it."""
        start = time.perf_counter()
        time_s = state.step / self.scenario.rate_hz
        now = self.situation(time_s, state.tracks)
        plan = self.planner.plan(now, state.functions)
        planned = time.perf_counter()
        lights, powers = self._driven(plan, time_s)
        lit = time.perf_counter()
        shown = tuple(Utilisation(u) for u in lights)
        plant, arrivals = self.plant.show(state.plant, Exposure(state.step, time_s, 1 / self.scenario.rate_hz, shown))
        seen, illuminance, luminance = self.plant.world.lit(time_s, shown)
        looked = time.perf_counter()
        tracks, functions, image, found, then, then_s = state.tracks, state.functions, None, None, seen, time_s
        for frame in arrivals.frames:
            if frame.image is not None:
                image, then_s = frame.image, frame.taken_s
                then = seen if then_s == time_s else self.camera.at(then_s)
                if self.sight is not None:
                    share = image / (2**self.scenario.camera.bits - 1)
                    found = self.sight.find(share, then)
                    tracks = self.sight.tracker.follow(tracks, found, share, then_s)
                if self.planner.learns:
                    functions = self.planner.step(functions, self._learnt(now, then, then_s, image, tracks))
        look = None if self.sight is None else self._look(self.sight, tracks, found, then, then_s, illuminance[seen.eyes])
        finished = time.perf_counter()
        masked = frozenset(each.name for each in now.objects if self.masked(each, now))
        told = told_as(self.watched, None if look is None else look.recognised)
        objects = on_objects(self.watched, frozenset(told[name] for name in masked & told.keys()), seen, illuminance)
        white = in_white(plan)
        symbols = () if white is None else observed_symbols(plan, lights, self._driven(white, time_s)[0], self.camera, time_s)
        zones = in_zones(self.planner.functions, state.functions, luminance, self.camera.view)
        materials = on_materials(self.planner.functions, functions, now, told, seen, illuminance, luminance)
        stop = time.perf_counter()
        taken = {"plan": planned - start, "light": lit - planned, "look": looked - lit + stop - finished, "find": finished - looked}
        timings = {part: 1e3 * seconds for part, seconds in taken.items()}
        result = LightingResult(
            state.step,
            time_s,
            now,
            state.functions,
            masked,
            plan,
            lights,
            powers,
            illuminance,
            luminance,
            image,
            objects,
            look,
            symbols,
            zones,
            materials,
            timings,
        )
        return LightingState(state.step + 1, tracks, functions, plant), result

    def at(self, step: int) -> LightingResult:
        """One step alone, before which nothing was seen; that of the run where nothing depends on what was seen."""
        return self.step(self.start(step))[1]

    def lights_at(self, time_s: float) -> tuple[Tensor, ...]:
        """Utilisations `[n_p]`, one a module, at any time; what depends on what was seen is run up to it."""
        state = self.start()
        while (self.sight is not None or self.planner.learns) and (state.step + 1) / self.scenario.rate_hz <= time_s:
            state, _ = self.step(state)
        return self._driven(self.planner.plan(self.situation(time_s, state.tracks), state.functions), time_s)[0]

    def base(self, beam: str) -> str:
        """What shines below all functions, in words, where the base beam is one of this name."""
        raw = [module.raw is not None for module in self.modules]
        told = "base beam off" if beam == "off" else f"{beam} beam"
        return "raw utilisations" if all(raw) else f"{told} and raw utilisations" if any(raw) else told

    def run(self) -> Iterator[LightingResult]:
        """All steps of the scenario."""
        state = self.start()
        for _ in range(self.scenario.steps):
            with located(self.scenario.source):
                state, result = self.step(state)
            yield result

    def masked(self, each: TrackedObject, now: Situation) -> bool:
        """Whether a glare-free function keeps all light off an object: its own mask is there, and not fading."""
        alone = replace(now, objects=(each,))
        functions = (function for function in self.scenario.functions.values() if isinstance(function, GlareFreeParams))
        there = each.since_s <= now.time_s < each.until_s
        return there and any(any(masks(part)) for function in functions for part in function.primitives(alone))

    def idle(self, result: LightingResult) -> set[str]:
        """Names of the functions of which no ray of any lamp that draws them can hit anything at that moment."""
        drawn = self.planner.drawn(result.now, result.functions)
        return {name for name, parts in drawn.items() if not any(map(self._in_reach, parts))}

    def _all_objects(self, time_s: float) -> tuple[TrackedObject, ...]:
        told = ((body, item.category) for body, item in zip(self.scene.objects, self.scenario.all_objects, strict=True))
        return tuple(TrackedObject.of(body, category, time_s) for body, category in told if category is not None)

    def _look(self, sight: Sight, tracks: Any, found: Detections | None, then: LitScene, then_s: float, eyes: Tensor) -> Look:
        """What is made of the scene at a time. found: in its frame, None without one. eyes: lx on heads and windscreens now."""
        found = found or Detections(torch.zeros(0, 4), torch.zeros(0, len(sight.classes)))
        present = sight.present(tracks, then_s)
        false = false_positives(then, found, self.scenario.tracker.start_score)
        return Look(found, present, recognised(then, present, found), false, float(eyes.max()) if len(eyes) else None)

    def _learnt(self, now: Situation, then: LitScene, then_s: float, image: Tensor, tracks: Any) -> Situation:
        """The situation once a frame is there, which was taken at then_s of the scene then."""
        camera = self.scenario.camera
        luminance, most = luminance_of(image, camera), saturation_luminance(camera)
        looks = any(function.kind == "material" for function in self.scenario.functions.values())
        materials = (then.surfaces.albedo, *then.materials) if looks else ()
        seen = Seen(then_s, self.view, luminance, most, *materials)
        objects = now.objects if self.sight is None or tracks is None else self.sight.objects(tracks, now.time_s)
        return replace(now, objects=objects, seen=seen)

    def _in_reach(self, primitives: Primitives) -> bool:
        for module in self.modules:
            mine = primitives.for_module(module.name)
            if any(not window.empty for window in projected_windows(mine, module.headlight, module.T_world_module.cpu())):
                return True
        return False

    def _driven(self, plan: Plan, time_s: float) -> tuple[tuple[Tensor, ...], Mapping[str, LampPower]]:
        params = self.scenario.lighting
        street_lamps = self.scene.street_lamps if params.street_lamps else ()
        occluded = scene_caster(self.scene.at(time_s)) if params.shadow_rays else None
        secondary = [SecondaryRays(self.lights, own, street_lamps, occluded) for own in range(len(self.modules))]
        return driven(self.modules, plan, secondary, params.power_limit, self.scenario.headlight.power_w)


def _as_they_are(scenario: LightingScenario, modules: Sequence[ShiningModule]) -> tuple[ShiningModule, ...]:
    """The modules with errors of aim, dead and aged pixels."""
    true = []
    for number, module in enumerate(modules):
        mounted = (module.headlight, module.T_world_module)
        headlight, T_world_module = as_it_is(scenario.disturbances, number, module.name, *mounted)
        true.append(replace(module, headlight=headlight, T_world_module=T_world_module))
    return tuple(true)


def driving(course: tuple[DrivingParams, ...], time_s: float) -> DrivingParams:
    """How the car drives at a time: speed and curvature change evenly from entry to entry, all else holds until the next."""
    past = [each for each in course if each.time_s <= time_s] or [course[0]]
    last, following = past[-1], next((each for each in course if each.time_s > time_s), None)
    if following is None or following is last:
        return last
    share = (time_s - last.time_s) / (following.time_s - last.time_s)
    between = {key: (1 - share) * getattr(last, key) + share * getattr(following, key) for key in ("speed_m_s", "curvature_1_m")}
    return last.model_copy(update=between)
