"""Lighting functions at work: at each step the objects are tracked, the functions planned, the lamps driven, and the light looked at."""

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from controllers.functions.situation import LightingFunction, Situation, TrackedObject
from controllers.planner import Plan, Planner
from controllers.primitives import Primitives
from controllers.rthc import masks
from controllers.secondary import Light, SecondaryRays, scene_caster
from controllers.windows import projected_windows
from loop.build import build_scene
from loop.lighting.lamps import LampPower, ShiningModule, driven, shining_modules
from loop.lighting.observed import ObservedSymbol, in_white, observed_symbols
from loop.lighting.view import Looker
from loop.scenario import DrivingParams, LightingScenario
from loop.shipped import named
from perception.camera import camera_view
from world.errors import LuxloopError, located
from world.face_source import face_source
from world.scene import Scene


@dataclass(frozen=True)
class OnObject:
    """The lamps' light on what the camera sees of an object: pixels, and lx that are NaN where there are none. masked: it must be dark."""

    pixels: int
    lx_min: float
    lx_mean: float
    lx_max: float
    masked: bool


@dataclass(frozen=True)
class LightingResult:
    """What happened in one step.

    lights: utilisations `[n_p]`, one a module. powers: by the lamps' sides. illuminance: `[height, width]` lx from the lamps alone, and
    luminance: in cd/m^2 with all other light, as the camera sees them. objects: by name, those that are there and tracked.
    symbols: those that are meant for an observer, from their eyes. timings: ms by part.
    """

    step: int
    time_s: float
    now: Situation
    plan: Plan
    lights: tuple[Tensor, ...]
    powers: Mapping[str, LampPower]
    illuminance: Tensor
    luminance: Tensor
    objects: Mapping[str, OnObject]
    symbols: tuple[ObservedSymbol, ...]
    timings: Mapping[str, float]

    @property
    def dark_lx_max(self) -> float | None:
        """The most light on any object that must be dark; None where nothing of any is in sight."""
        found = [each.lx_max for each in self.objects.values() if each.masked and each.pixels]
        return max(found, default=None)

    @property
    def symbol_iou_min(self) -> float | None:
        """The least overlap of a symbol with what its observer shall see; None where there is no such symbol."""
        return min((each.iou for each in self.symbols), default=None)


@dataclass(frozen=True, eq=False)
class LightingSimulation:
    """A lighting scenario made ready to run on one device. Its steps depend on nothing but their time."""

    scenario: LightingScenario
    device: torch.device
    planner: Planner
    scene: Scene
    modules: tuple[ShiningModule, ...]
    lights: tuple[tuple[str, Light], ...]
    camera: Looker

    @classmethod
    def prepare(cls, scenario: LightingScenario, device: torch.device | str = "cpu") -> "LightingSimulation":
        """Build scene and lamps, load symbols, plan a step. Raises LuxloopError where something is missing, beams included, or broken."""
        with located(scenario.source):
            return cls._prepare(scenario, torch.device(device))

    @classmethod
    def _prepare(cls, scenario: LightingScenario, device: torch.device) -> "LightingSimulation":
        planner = Planner.prepare(scenario.lighting, lambda image: named(image, "symbols"))
        scene = build_scene(scenario)
        modules = shining_modules(scenario, device)
        _check_names(scenario, modules)
        camera = Looker(scene, camera_view(scenario.camera), modules, face_source(scenario.renderer), device)
        lights = tuple((module.name, Light.of(module.headlight, module.T_world_module)) for module in modules)
        simulation = cls(scenario, device, planner, scene, modules, lights, camera)
        planner.plan(simulation.situation(0.0))
        for module in modules:
            for name in scenario.lighting.base.names if module.raw is None else ():
                module.lamp.beam(name)
        return simulation

    def situation(self, time_s: float) -> Situation:
        """What the car knows at a time, from a tracker that makes no mistakes."""
        categories = ((body, item.category) for body, item in zip(self.scene.objects, self.scenario.all_objects, strict=True))
        drive = driving(self.scenario.driving, time_s)
        return Situation(
            time_s,
            torch.eye(4, dtype=torch.float64),
            torch.stack([module.T_world_module[:3, 3].double().cpu() for module in self.modules]),
            tuple(TrackedObject.of(body, category, time_s) for body, category in categories if category is not None),
            drive.speed_m_s,
            drive.curvature_1_m,
            drive.wet,
            drive.street_lit,
        )

    def step(self, step: int) -> LightingResult:
        """One step."""
        start = time.perf_counter()
        time_s = step / self.scenario.rate_hz
        now = self.situation(time_s)
        plan = self.planner.plan(now)
        planned = time.perf_counter()
        lights, powers = self._driven(plan, time_s)
        lit = time.perf_counter()
        seen = self.camera.at(time_s)
        illuminance, luminance = seen.light(lights)
        objects = self._on_objects(illuminance, seen.surfaces.object_id, now)
        white = in_white(plan)
        symbols = () if white is None else observed_symbols(plan, lights, self._driven(white, time_s)[0], self.camera, time_s)
        stop = time.perf_counter()
        timings = {"plan": 1e3 * (planned - start), "light": 1e3 * (lit - planned), "look": 1e3 * (stop - lit)}
        return LightingResult(step, time_s, now, plan, lights, powers, illuminance, luminance + seen.base, objects, symbols, timings)

    def lights_at(self, time_s: float) -> tuple[Tensor, ...]:
        """Utilisations `[n_p]`, one a module, at any time."""
        return self._driven(self.planner.plan(self.situation(time_s)), time_s)[0]

    def base(self, beam: str) -> str:
        """What shines below all functions, in words, where the base beam is one of this name."""
        raw = [module.raw is not None for module in self.modules]
        return "raw utilisations" if all(raw) else f"{beam} beam and raw utilisations" if any(raw) else f"{beam} beam"

    def run(self) -> Iterator[LightingResult]:
        """All steps of the scenario."""
        return (self.step(step) for step in range(self.scenario.steps))

    def masked(self, name: str, now: Situation) -> bool:
        """Whether a glare-free function keeps all light off an object: its own mask is there, and not fading."""
        alone = replace(now, objects=tuple(each for each in now.objects if each.name == name))
        functions = (function for function in self.scenario.lighting.functions if function.kind == "glare_free")
        return any(any(masks(part)) for function in functions for part in function.primitives(alone))

    def idle(self, now: Situation) -> set[int]:
        """Functions, by their place in the scenario, of which no ray of any lamp that draws them can hit anything at that moment."""
        now = replace(now, symbols=dict(self.planner.symbols))
        functions: tuple[LightingFunction, ...] = self.scenario.lighting.functions
        return {number for number, each in enumerate(functions) if not any(map(self._in_reach, each.primitives(now)))}

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
        return driven(self.modules, plan, secondary, params.power_limit)

    def _on_objects(self, illuminance: Tensor, object_id: Tensor, now: Situation) -> Mapping[str, OnObject]:
        found = {}
        for number, (body, item) in enumerate(zip(self.scene.objects, self.scenario.all_objects, strict=True), 1):
            if item.category is None:
                continue
            lx = illuminance[object_id == number]
            low, mean, high = (float(value) for value in (lx.min(), lx.mean(), lx.max())) if len(lx) else [math.nan] * 3
            found[item.name] = OnObject(len(lx), low, mean, high, body.track.visible_at(now.time_s) and self.masked(item.name, now))
        return found


def driving(course: tuple[DrivingParams, ...], time_s: float) -> DrivingParams:
    """How the car drives at a time: speed and curvature change evenly from entry to entry, all else holds until the next."""
    past = [each for each in course if each.time_s <= time_s] or [course[0]]
    last, following = past[-1], next((each for each in course if each.time_s > time_s), None)
    if following is None or following is last:
        return last
    share = (time_s - last.time_s) / (following.time_s - last.time_s)
    between = {key: (1 - share) * getattr(last, key) + share * getattr(following, key) for key in ("speed_m_s", "curvature_1_m")}
    return last.model_copy(update=between)


def _check_names(scenario: LightingScenario, modules: tuple[ShiningModule, ...]) -> None:
    """Raises LuxloopError where raw utilisations or a function are meant for a lamp, module or object that is not there."""
    known = dict.fromkeys(word for module in modules for word in (*module.name.split(" ", 1), module.name))
    objects = [item.name for item in scenario.all_objects if item.category is not None]
    for key, each in (("raw", scenario.lighting.raw), ("functions", scenario.lighting.functions)):
        for number, item in enumerate(each):
            for name in getattr(item, "modules", ()):
                if name not in known:
                    where = f"lighting.{key}[{number}].modules"
                    raise LuxloopError(f"{where}: there is no lamp or module {name!r}; there are {', '.join(known)}")
    for number, function in enumerate(scenario.lighting.functions):
        for key, name in _objects_named(function):
            if name not in objects:
                raise LuxloopError(
                    f"lighting.functions[{number}].{key}: there is no object {name!r} with a category; there are "
                    f"{', '.join(objects) or 'none'}, an object is tracked if it has a category"
                )


def _objects_named(function: LightingFunction) -> Iterator[tuple[str, str]]:
    """The objects that a function names, each after its key."""
    for table in ("", "when.", "unless."):
        selection = getattr(function, table[:-1], None) if table else function
        yield from ((f"{table}names", name) for name in getattr(selection, "names", None) or ())
    if (observer := getattr(function, "observer", None)) is not None and observer.name is not None:
        yield "observer.name", observer.name
