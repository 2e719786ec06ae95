"""The simulated world as a plant: its road, scene and motion, and a module whose light may be measured on a real lamp."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.pixels.primitives import names_module
from luxloop.loop.scenario import data
from luxloop.loop.scenario.disturbances import UNDISTURBED, DisturbanceParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Plant
from luxloop.loop.simulation.truth import LampModule, true_camera, true_modules
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import expose, glare
from luxloop.perception.egomotion import Sample
from luxloop.perception.noise import FrameNoise
from luxloop.perception.sensors import EXACT, SensorParams, Sensors
from luxloop.world.caches import Part
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.materials.library import SpottedTexture
from luxloop.world.rendering.surfaces import FirstFound, face_source
from luxloop.world.roads.base import Road
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.scene.body import Body, Figure
from luxloop.world.scene.ground import AROUND_M, SIGHT_M, RoadPatches, RoadTiles, StandingRoad
from luxloop.world.scene.scene import SUN_M, Ground, Scene
from luxloop.world.scene.vehicle import STANDING, LateBody, Motion, drive
from luxloop.world.traffic.objects import ObjectParams


def find_road(road: Road) -> Road:
    """A road with the path of its file on this machine. Raises LuxloopError for a missing file."""
    return road.model_copy(update={"file": data.locate(road.file)}) if isinstance(road, OpenCrgRoad) else road


def build_motion(scenario: Scenario, cache: PartCache) -> Motion:
    """Vehicle motion, one step longer than the scenario, with the body delay of a digitised module.

    Raises LuxloopError for a missing or broken file.
    """
    if (vehicle := scenario.vehicle) is None:
        return STANDING
    rate_hz, key = scenario.rate_hz, (vehicle, find_road(scenario.road), (scenario.steps + 1) / scenario.rate_hz)
    motion = cache("motion", lambda *_: drive(*key, cache.before("motion", STANDING)), *key)
    late = max((each.late_steps(rate_hz) for each in scenario.modules.values() if each.delay_body), default=0)
    return LateBody.behind(motion, late / rate_hz) if late else motion


def build_scene(scenario: Scenario, motion: Motion = STANDING, cache: PartCache | None = None) -> Scene:
    """Road along the vehicle's course, and objects. Raises LuxloopError for a missing or broken file."""
    cache, vehicle, road, albedo = cache or PartCache(), scenario.vehicle, find_road(scenario.road), scenario.surface.albedo
    texture = cache("texture", SpottedTexture, scenario.surface, scenario.spots, motion is not STANDING)
    objects = tuple(cache(f"object {item.name}", body_of, item, road) for item in scenario.all_objects)
    sight_m = SIGHT_M if scenario.traffic is None else max(SIGHT_M, scenario.traffic.sight_m + AROUND_M)
    ground: Ground
    if motion is STANDING:
        ground = cache("ground", StandingRoad, road, albedo, texture)
    elif vehicle is not None and vehicle.roams:
        ground = cache("ground", RoadPatches, road, albedo, texture, sight_m)
    else:
        others_y_m = tuple(y for each in objects for y in each.track.T_world_body[:, 1, 3].tolist())
        ground = cache("ground", RoadTiles, road, albedo, texture, motion.range_y_m, others_y_m, sight_m)
    light = scenario.light
    return cache("scene", Scene, (ground, *objects), light.ambient_lx, light.street_lamps, scenario.air, light.sun, light.interreflection)


def body_of(item: ObjectParams, road: Road) -> Body | Figure:
    """An object of a scenario. Raises LuxloopError for a missing or broken file."""
    body = item.build()
    return replace(body, track=replace(body.track, road=road, wheels_m=item.wheels_m)) if item.on_road else body


LOSS_KEY, LATENCY_KEY, DROPS_KEY = 2, 4, 8  # random streams of a step, separate from the noise of frames and sensors

UnderWay = tuple[tuple[int, Frame], ...]  # (number of the exposure at whose end the frame arrives, frame)


@dataclass(frozen=True, eq=False)
class SimulatedPlant:
    """Exposes frames of a world. State: queue of frames in transit from the camera.

    shares: durations of the exposures as shares of a control step. drawings: number of exposures with an on frame.
    """

    world: World
    rate_hz: float
    seed: int
    sensors: SensorParams = EXACT
    disturbances: DisturbanceParams = UNDISTURBED
    shares: tuple[float, ...] = (0.5, 0.5)
    drawings: int = 1

    @property
    def period_s(self) -> float:
        return 1 / self.rate_hz

    @property
    def truth(self) -> World:
        """The true world."""
        return self.world

    @property
    def dynamics(self) -> Motion:
        """Motion measured by the vehicle's sensors, without the delay of a late body."""
        motion = self.world.motion
        return motion.dynamics if isinstance(motion, LateBody) else motion

    def start(self) -> tuple[UnderWay, Arrivals]:
        """An empty queue, and arrivals at 0 s."""
        return (), Arrivals(0.0, samples=self.samples(0.0))

    def show(self, state: UnderWay, exposure: Exposure) -> tuple[UnderWay, Arrivals]:
        """Show an exposure; its frame, if any, arrives after the camera's latency and in order."""
        per_step = len(self.shares)
        step, part = divmod(exposure.number, per_step)
        begins_s, ends_s = (self._at(number) for number in (exposure.number, exposure.number + 1))
        queue = state
        if exposure.frame:
            image = None if self.loses(step) else self._frame(exposure, step, int(part > 0))
            due = max([exposure.number + per_step * self._latency(step), *(number for number, _ in state)])
            queue = (*state, (due, Frame(exposure.number, exposure.start_s, ends_s, image)))
        come = tuple(replace(frame, arrived_s=ends_s) for number, frame in queue if number <= exposure.number)
        return queue[len(come) :], Arrivals(ends_s, come, self.samples(ends_s, begins_s))

    def samples(self, by_s: float, after_s: float | None = None) -> tuple[Sample, ...]:
        """Sensor samples of a moving vehicle that arrive after after_s, by by_s. after_s None: the newest of each sensor."""
        if self.world.motion.stands:
            return ()
        sensors, like = Sensors(self.dynamics, self.sensors, self.period_s, self.seed), torch.empty(0, device=self.world.device)
        return sensors.newest(by_s, like) if after_s is None else sensors.arriving(after_s, by_s, like)

    def _frame(self, exposure: Exposure, step: int, frame: int) -> Tensor:
        """Digital numbers `[height, width]`, computed on access; immediately behind a soiled lens, which needs the whole, and
        for measured light, which is stored only briefly.
        """
        shown = exposure.start_s, exposure.lights, exposure.commands

        @cache
        def drops() -> Tensor | None:
            return self.world.drops(*shown, self._draw(step, DROPS_KEY + frame))

        def part_of(part: Part) -> Tensor:
            luminance, base = self.world.luminance(*shown, part)
            if (falling := drops()) is not None:
                luminance = (luminance + falling[part]).clamp(min=0)
            return self.exposed(luminance, base, step, frame, part)

        image = self.world.image(exposure.lights[0].u, part_of)
        at_once = self.disturbances.lens_in(step) or any(module.measured for module in self.world.modules)
        return image[:, :] if at_once else image

    def exposed(self, luminance: Tensor, base: Tensor, step: int, frame: int, part: Part | None = None) -> Tensor:
        """Digital numbers of frame 0, 1, ... of a step, with disturbances. luminance: `[..., height, width]` cd/m^2.

        base: `[height, width]` cd/m^2, luminance without the lamps. part: rows and columns of the image, None for all.
        """
        view, camera, device = self.world.view, self.world.camera, self.world.device
        part = part or view.whole
        ambient, noisy = self.disturbances.ambient_factor(step, frame), self.disturbances.noise_factor(step)
        if ambient != 1:
            luminance = luminance + (ambient - 1) * base
        t_s = self._at(len(self.shares) * step + frame * self.drawings)
        for lamp in self.disturbances.oncoming_in(step, frame):
            view, position, medium = self.world.view_at(t_s), lamp.position_at(t_s), self.world.scene.air_at(t_s)
            dimmed = 1.0 if medium is None else float(medium.transmittance(position - view.origin))
            luminance = luminance + dimmed * glare(view.within(*part), position, lamp, device)
        if (sun := self.world.scene.sun) is not None:
            view = self.world.view_at(t_s)
            if self.world.sees(position := view.origin + SUN_M * sun.direction, t_s):
                luminance = luminance + glare(view.within(*part), position, sun, device)
        for soiling in self.disturbances.lens_in(step):
            luminance = soiling.through(luminance)
        noise = FrameNoise.of(self.seed, step, frame).part(part, luminance) if camera.noise else None
        return expose(luminance, camera, noise if noise is None or noisy == 1 else noisy * noise)

    def _at(self, number: int) -> float:
        """Start time of an exposure in s."""
        step, part = divmod(number, len(self.shares))
        return (step + sum(self.shares[:part])) * self.period_s

    def loses(self, step: int) -> bool:
        """Whether the frames of a step are lost."""
        p = self.disturbances.loss_probability(step, self.world.camera.drop_probability)
        return p > 0 and bool(self._draw(step, LOSS_KEY).random() < p)

    def _latency(self, step: int) -> int:
        camera = self.world.camera
        spread = camera.latency_spread_steps
        return camera.latency_steps + (int(self._draw(step, LATENCY_KEY).integers(spread, endpoint=True)) if spread else 0)

    def _draw(self, step: int, key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(step, key)))


def simulated_plant(scenario: Scenario, modules: Sequence[LampModule], cache: PartCache | None = None) -> SimulatedPlant:
    """The simulated plant of a scenario, lit by these modules. cache: reusable parts, None for none. Raises LuxloopError for a missing or
    broken file.
    """
    cache, errors = cache or PartCache(), scenario.disturbances
    motion = build_motion(scenario, cache)
    scene = build_scene(scenario, motion, cache)
    source = cache("face source", lambda name: FirstFound() if name == "auto" else face_source(name), scenario.renderer)
    true = cache("true modules", true_modules, tuple(modules), errors.aim, errors.wear, errors.cover)
    world = _world(cache, scene, true, true_camera(scenario), source, motion, scenario.meters_light, scenario.all_objects)
    return SimulatedPlant(world, scenario.rate_hz, scenario.seed, scenario.sensors, errors, scenario.shares, scenario.drawings[0])


def driven_plant(plant: SimulatedPlant, scenario: Scenario, cache: PartCache) -> SimulatedPlant:
    """The plant with the vehicle motion of a scenario. cache: parts of the plant; motion and world are replaced."""
    old = plant.world
    motion = build_motion(scenario, cache)
    return replace(plant, world=_world(cache, old.scene, old.modules, old.camera, old.source, motion, old.metered, old.given))


def _world(cache: PartCache, *parts: Any) -> World:
    return cache("world", lambda *key: World(*key).after(cache.before("world", None)), *parts)


def world_plant(plant: Plant, asked: str) -> SimulatedPlant:
    """The plant, if it is the simulated world. Raises LuxloopError otherwise. asked: what needs this world, the start of the message."""
    if not isinstance(plant, SimulatedPlant):
        raise LuxloopError(f'{asked}: needs the simulated world; set plant.kind = "simulated", and digitise no module')
    return plant


KEPT: Final = 8  # number of stored light textures; on and off exposures alternate


class MeasuredTextures:
    """Measured light textures of a real lamp for its last utilisations; computed ones of a headlight for any other utilisation."""

    def __init__(self, headlight: Headlight) -> None:
        self._headlight, self._kept = headlight, deque[tuple[Tensor, Tensor]](maxlen=KEPT)

    def keep(self, utilisation: Tensor, texture: Tensor) -> None:
        """Store a measurement. utilisation: `[n_p]`, as shown. texture: `[rows, cols]` cd, as measured."""
        self._kept.append((utilisation, texture.to(utilisation)))

    def light_texture(self, utilisation: Tensor, band: slice | None = None) -> Tensor:
        """Luminous intensity `[..., rows, cols]` in cd of a utilisation `[..., n_p]`."""
        for shown, texture in reversed(self._kept):
            if shown is utilisation or torch.equal(shown, utilisation):
                return texture
        return self._headlight.light_texture(utilisation, band)


@dataclass(frozen=True, eq=False)
class DigitisedPlant:
    """A simulated world awaiting a lamp from `luxloop run --rig`. It can be inspected, but not started.

    key: of the module in the scenario. number: index of the module. measured: its light textures. late: delay of its light in exposures.
    """

    night: SimulatedPlant
    key: str
    number: int
    measured: MeasuredTextures
    late: int

    @property
    def truth(self) -> World:
        """The true world."""
        return self.night.world

    def start(self) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        raise LuxloopError(needs_rig(self.key))

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        return self.start()


def needs_rig(key: str) -> str:
    """Error text: the scenario needs a rig. key: of the digitised module in the scenario."""
    return f"{key}: is digitised from a real lamp; run it with `luxloop run NAME --rig FILE`, or play a recording of it with --plant"


def digitised_plant(scenario: Scenario, modules: Sequence[LampModule], cache: PartCache | None = None) -> DigitisedPlant:
    """The plant of a scenario with a digitised module. Raises LuxloopError as `digitised_number` and `simulated_plant`."""
    number = digitised_number(scenario, [each.name for each in modules])
    measured = MeasuredTextures(modules[number].headlight)
    shining = [replace(each, measured=measured) if k == number else each for k, each in enumerate(modules)]
    late = max(each.late_steps(scenario.rate_hz) for each in scenario.modules.values()) * len(scenario.shares)
    return DigitisedPlant(simulated_plant(scenario, shining, cache), f"modules.{scenario.digitised_module}", number, measured, late)


def digitised_number(scenario: Scenario, names: Sequence[str]) -> int:
    """Index of the digitised module among the names of shining modules. Raises LuxloopError unless exactly one has its name."""
    name = scenario.digitised_module or ""
    found = [k for k, each in enumerate(names) if names_module([name], each)]
    if len(found) != 1:
        told = f"{len(found)} modules are called {name!r}" if found else f"there is no module {name!r}"
        raise LuxloopError(f"modules.{name}: {told}; name one of {', '.join(names)}")
    return found[0]
