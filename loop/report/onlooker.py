"""What people see of a run, in colour, from any view, and the video of a run at its own rate."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.recording.video import NOISY_CRF, VideoWriter
from luxloop.loop.report.picture import frame_picture, white_of
from luxloop.loop.report.views import above, chase, driver, oncoming
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.result import mean_lights
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import LitScene, World
from luxloop.perception.eye import develop, exposure_of, smooth, veil
from luxloop.world.caches import Part
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.frames import View, inverse, pose_from_degrees, transform
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import REST, Commands
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.light.emitters import spot_intensity
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.rendering.raycast import sees
from luxloop.world.scene.scene import SUN_M, Ground
from luxloop.world.scene.triangles import Group, Instance, Triangles
from luxloop.world.scene.vehicle import VehiclePath
from luxloop.world.traffic.car import CarParams
from luxloop.world.traffic.colours import GRASS, SKY, WHITE, colour
from luxloop.world.traffic.tracked import KeyframeParams

LAMP_M: Final = 0.3  # by which a lamp's point lies inside its body
NOSE_M: Final = 0.05  # from the own car's lamps to its front end
EDGE_M: Final = 0.4  # of the asphalt beyond a lane
BEHIND_M: Final = 20.0  # behind the car up to which the road is seen from behind it
BEHIND_ONCOMING_M: Final = 80.0  # and from an oncoming car


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel, in linear sRGB, of a coloured headlight's light."""

    headlight: Headlight
    number: int

    def light_texture(self, utilisation: Tensor, band: slice | None = None) -> Tensor:
        """As of `Headlight.light_texture`."""
        return self.headlight.colour_texture(utilisation)[..., self.number, :, :]


@dataclass(frozen=True, eq=False)
class Onlooker:
    """A person's view of a world, on the CPU.

    view: in the ground frame. duration_s: of the drive, whose course has the lane and one for oncoming traffic on its left, between grass.
    with_car: whether the own car is in sight. rides: name of the object in whose frame the view is instead; its body is not seen, and the
    own lamps dazzle.
    """

    world: World
    view: View
    duration_s: float
    lane_width_m: float
    age_years: float = 40.0
    with_car: bool = False
    rides: str | None = None

    @classmethod
    def of(cls, simulation: Simulation, view: View, with_car: bool = False, rides: str | None = None) -> "Onlooker":
        """A view of a simulation's world. Raises LuxloopError if the plant does not know it."""
        scenario = simulation.scenario
        duration_s = scenario.steps / scenario.rate_hz
        return cls(simulation.world, view, duration_s, scenario.surface.lane_width_m, scenario.video.age_years, with_car, rides)

    def light(self, time_s: float, lights: Sequence[Tensor], commands: Commands = ()) -> Tensor:
        """Light `[3, H, W]` in cd/m^2 that enters the eye, linear sRGB, without glare; its luminance is what a camera there
        measures, and above the horizon that of an even sky.

        lights: utilisations `[n_p]`, one a module.
        """
        return self._light(self._lit(time_s), lights, commands)

    def picture(self, time_s: float, lights: Sequence[Tensor], commands: Commands, exposure_ev: float) -> np.ndarray:
        """sRGB picture `[H, W, 3]` uint8 of the light on the retina."""
        lit = self._lit(time_s)
        shown = smooth(develop(self._light(lit, lights, commands) + self.glare(lit, lights, commands), exposure_ev))
        return (255 * shown).round().byte().movedim(0, -1).cpu().numpy()

    @cached_property
    def _own_car(self) -> Instance:
        """The car that carries the lamps, in its body frame."""
        params = CarParams(name="own_car", seed=3, style="saloon", track=(KeyframeParams(position_m=(0.0, 0.0, 0.0)),))
        body = params.build()
        return Instance(len(self.world.scene.bodies), body, pose_from_degrees((-NOSE_M - float(body.bounds[1, 0]), 0.0, 0.0)))

    def _lit(self, time_s: float) -> LitScene:
        lit = self.world.through(self._view_from_ground(time_s), time_s)
        if not self.with_car:
            return lit
        own = replace(self._own_car, T_world_body=lit.vehicle.T_world_body @ self._own_car.T_world_body)
        everybody = Triangles((*self._others(lit).groups, Group((*self._road_behind(lit), own))))

        def render(_: Triangles, view: View, part: Part | None) -> GBuffer:
            return self.world.surfaces.gbuffer(everybody, view, part)

        return replace(lit, render=render)

    def _view_from_ground(self, time_s: float) -> View:
        if self.rides is None:
            return self.view
        track = next(each.track for each in self.world.scene.objects if each.name == self.rides)
        T_ground_object = inverse(self.world.motion.at(time_s).T_world_ground) @ track.pose_at(time_s)
        return replace(self.view, T_world_view=T_ground_object @ self.view.T_world_view)

    def _others(self, lit: LitScene) -> Triangles:
        """All bodies but the one that carries the eye."""
        if self.rides is None:
            return lit.triangles
        groups = (Group(tuple(each for each in group.placed if each.body.name != self.rides)) for group in lit.triangles.groups)
        return Triangles(tuple(group for group in groups if group.placed))

    def _road_behind(self, lit: LitScene) -> tuple[Instance, ...]:
        """Parts of the road that only somebody behind the car sees."""
        road, T_world_ground = self.world.scene.bodies[0], lit.vehicle.T_world_ground
        if not isinstance(road, Ground):
            return ()
        behind_m = BEHIND_M if self.rides is None else BEHIND_ONCOMING_M
        near = road.near(0, T_world_ground @ pose_from_degrees((-behind_m, 0.0, 0.0)))
        T_ground_world = inverse(T_world_ground)
        return tuple(each for each in near if each not in lit.triangles.placed and transform(T_ground_world, each.box.T)[0].mean() < 0)

    def _light(self, lit: LitScene, lights: Sequence[Tensor], commands: Commands) -> Tensor:
        weight = torch.tensor(LUMINANCE)[:, None, None]
        sky = (lit.surfaces.object_id < 0).cpu() * (lit.backscatter is None) * lit.scene.ambient_lx / math.pi
        haze, ambient_lx = lit.rendered.haze, lit.scene.ambient_lx
        air = 0.0 if haze is None else ((1 - haze.transmittance) * haze.medium.horizon(ambient_lx)).cpu()
        arriving = (self._from_lamps(lit, lights, commands) + lit.base).cpu() - air + sky
        seen = arriving * self._colours(lit)
        coloured = seen * (weight * arriving).sum(0) / (weight * seen).sum(0).clamp(min=1e-12)
        return coloured + air + torch.as_tensor(lit.backscattered([Utilisation(u) for u in lights], commands)).cpu()

    def _from_lamps(self, lit: LitScene, lights: Sequence[Tensor], commands: Commands) -> Tensor:
        """Luminance `[3, H, W]` from the lamps in linear sRGB, of grey surfaces."""
        if all(module.headlight.chroma is None for module in lit.modules):
            return lit.light(lights, commands)[1].expand(3, -1, -1)
        channels = list[Tensor]()
        for number in range(len(LUMINANCE)):
            modules = tuple(replace(each, measured=Channel(each.headlight, number)) for each in lit.modules)
            seen = replace(lit, modules=modules, render=lambda *_: lit.rendered, indirect=None)
            channels.append((seen.with_indirect() if lit.indirect else seen).light(lights, commands)[1])
        return torch.stack(channels)

    def _colours(self, lit: LitScene) -> Tensor:
        """Colours `[3, H, W]` of the surfaces at luminance 1."""
        surfaces, placed = lit.surfaces.to(torch.device("cpu")), {each.object_id: each for each in (*lit.triangles.placed, self._own_car)}
        table, first = [WHITE, GRASS, SKY], torch.zeros(max(placed) + 2, dtype=torch.int64)
        for number, each in placed.items():
            if each.body.parts:
                banded = any(part.name == "bands" for part in each.body.parts)
                first[number + 1] = len(table)
                table += [colour(each.body.name, part, banded) for part in each.body.parts]
        start = first[surfaces.object_id.long() + 1]
        index = start if surfaces.part is None else start + torch.where(start > 0, surfaces.part, 0)
        index[self._on_grass(surfaces)], index[surfaces.object_id < 0] = 1, 2
        return torch.tensor(table)[index].movedim(-1, 0)

    def _on_grass(self, surfaces: GBuffer) -> Tensor:
        """Where `[H, W]` bool the ground lies beside the lanes."""
        x, y, _ = (each.cpu().numpy() for each in surfaces.position)
        at = self._course.aside_m(x, y)
        right, left = -self.lane_width_m / 2 - EDGE_M, 1.5 * self.lane_width_m + EDGE_M
        return (surfaces.object_id == 0) & torch.from_numpy((at < right) | (at > left))

    @cached_property
    def _course(self) -> VehiclePath:
        return VehiclePath.of(self.world.motion, self.duration_s)

    def glare(self, lit: LitScene, lights: Sequence[Tensor], commands: Commands = ()) -> Tensor:
        """Veil `[3, H, W]` in cd/m^2, linear sRGB, of the lamps that shine into the eye: those of others and of streets, and the own ones
        if the eye rides along.
        """
        eye = lit.eye.origin[:, None]
        spots = ((spot, spot.position.double()[:, None]) for spot in lit.scene.spotlights_at(lit.time_s))
        shining = [(place, float(spot_intensity(spot, (eye - place).float())), spot.rgb) for spot, place in spots]
        shining += [(torch.tensor(each.position_m).double()[:, None], each.intensity_cd, WHITE) for each in lit.scene.street_lamps]
        if (sun := lit.scene.sun) is not None:
            shining.append((eye + SUN_M * sun.direction[:, None], sun.intensity_cd, WHITE))
        if self.rides is not None:
            for module, u, command in zip(lit.modules, lights, commands or (REST,) * len(lights), strict=True):
                T = lit.vehicle.T_world_body @ module.turned(command)
                cd = module.headlight.intensity(module.textures.light_texture(u).cpu(), T[:3, :3].T @ (eye - T[:3, 3:]))
                shining.append((T[:3, 3:], command.intensity * float(cd), WHITE))
        total = torch.zeros(3, self.view.height, self.view.width)
        for rgb in {rgb for *_, rgb in shining}:
            places = torch.cat([place for place, _, each in shining if each == rgb], 1)  # [3, n]
            intensities = torch.tensor([cd for _, cd, each in shining if each == rgb])
            away = places - eye
            lx = intensities * lux_per_cd(away, lit.eye.T_world_view[:3, 2:3]).float()
            if (medium := lit.scene.air_at(lit.time_s)) is not None:
                lx = lx * medium.transmittance(away).float()
            seen = sees(self._others(lit), lit.eye.origin, places, LAMP_M) & (lx > 0)
            total += torch.tensor(rgb)[:, None, None] * veil(lit.eye, places[:, seen], lx[seen], self.age_years)
        return total


def first_oncoming(simulation: Simulation) -> str:
    """Name of the first car that comes towards the own one at the start and exists until the end. Raises LuxloopError if there is none."""
    world, end_s = simulation.world, (simulation.scenario.steps - 1) / simulation.scenario.rate_hz
    T_ground_world = inverse(world.motion.at(0.0).T_world_ground)
    for given, body in zip(world.given, world.scene.objects, strict=True):
        T = T_ground_world @ body.track.pose_at(0.0)
        there = body.track.visible_at(0.0) and body.track.visible_at(end_s)
        if there and given.category == "car" and float(T[0, 0]) < 0 < float(T[0, 3]):
            return body.name
    raise LuxloopError(f"no car comes towards the own one from 0 to {end_s:g} s; add one, take fewer steps, or choose another view")


CAMERA_HZ = 10  # slower than most loops, so that single steps are visible
CLEAN_CRF = 20
ROUNDING_S = 1e-9
VIEWS = {"driver": driver, "chase": chase, "above": above, "oncoming": oncoming}


class Film(VideoWriter):
    """A video of the scenario's `video.view`."""

    def __init__(self, path: Path, simulation: Simulation) -> None:
        """Raises LuxloopError where the file cannot be written, or the plant does not know what people see."""
        scenario, self._simulation = simulation.scenario, simulation
        self._onlooker: Onlooker | None = None
        self._white: Tensor | None = None
        self._before: tuple[float, Sequence[Tensor]] | None = None
        wanted = scenario.video
        size, rate_hz = (scenario.camera.width_px, scenario.camera.height_px), float(CAMERA_HZ)
        if wanted.view != "camera":
            view, rate_hz = VIEWS[wanted.view](wanted.width_px), wanted.rate_hz
            size = view.width, view.height
            with locate(f"video.view = {wanted.view!r}"):
                rides = first_oncoming(simulation) if wanted.view == "oncoming" else None
                self._onlooker = Onlooker.of(simulation, view, with_car=wanted.view != "driver", rides=rides)
        self._exposure_ev, self._rate_hz, self._frames = wanted.exposure_ev, rate_hz, 0
        super().__init__(path, rate_hz, size, NOISY_CRF if self._onlooker is None else CLEAN_CRF)

    def step(self, result: Evaluation) -> None:
        """Add a step: one frame of the camera, or all frames since the step before, each with the light of the nearer step."""
        if self._onlooker is None:
            self._white = white_of(result, self._simulation) if self._white is None else self._white
            self.add(frame_picture(result, self._simulation, self._white))
            return
        time_s, commands = result.time_s, result.now.commands
        lights = mean_lights(result, self._simulation.scenario.shares)
        if self._exposure_ev is None:
            self._exposure_ev = exposure_of(self._onlooker.light(time_s, lights, commands))
        before_s, earlier = self._before or (time_s, lights)
        while (now_s := self._frames / self._rate_hz) <= time_s + ROUNDING_S:
            nearer = earlier if now_s - before_s < time_s - now_s else lights  # a mixture would show symbols twice
            self.add(self._onlooker.picture(now_s, nearer, commands, self._exposure_ev))
            self._frames += 1
        self._before = time_s, lights
