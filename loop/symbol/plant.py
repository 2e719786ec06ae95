"""What is controlled: utilisations in, frames out. The simulated world is the first plant."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from loop.scenario.disturbances import UNDISTURBED, DisturbanceParams
from loop.symbol.truth import LampModule
from perception.camera import CameraParams, average_rows, camera_view, expose, frame_generator
from perception.egomotion import EXACT, Ego, SensorParams, measured
from perception.glare import glare
from world.light.ambient import ambient_luminance
from world.light.illumination import DirectTransport, LightTransport, added_light, reach, transport
from world.rendering.face_source import FaceSource
from world.rendering.gbuffer import GBuffer
from world.rendering.surfaces import surface_source
from world.scene.scene import Scene
from world.scene.triangles import NOTHING, Triangles
from world.scene.vehicle import STANDING, Motion
from world.view import View

KEPT_VIEWS = 4  # on and off frame, before and after a change

Frames = tuple[Tensor, Tensor]


class Plant(Protocol):
    """Shows utilisations and returns what the camera sees; its state is a value, so that a run can be taken up anywhere."""

    def start(self) -> Any:
        """The plant's state before step 0."""
        ...

    def show(self, state: Any, lights: Sequence[Utilisation], step: int) -> tuple[Any, Frames | None]:
        """Show one utilisation `[n_p]` a module; returns the on and off frames `[height, width]` (digital numbers) that arrive now."""
        ...


@dataclass(frozen=True, eq=False)
class LitView:
    """A scene as the camera sees it at one time.

    base: luminance `[height, width]` in cd/m^2 without the lamps. beams: their base beams, None where they have none.
    transported: makes the transports, which are needed only where a lamp shines.
    """

    base: Tensor
    beams: Sequence[Utilisation] | None
    transported: Callable[[], tuple[LightTransport, ...]]

    @cached_property
    def transports(self) -> tuple[LightTransport, ...]:
        """Light transport, one a module."""
        return self.transported()

    @cached_property
    def off(self) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 with the base beams, as an off frame shows it."""
        return self.base if self.beams is None else added_light(self.transports, self.beams, self.base)

    def luminance(self, lights: Sequence[Utilisation]) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of the symbol alone: on minus off, negative where it is darker than the base beams."""
        return added_light(self.transports, lights, self.base - self.off)


class SimulatedPlant:
    """The world in simulation. Its state is the queue of frames that are under way from the camera."""

    def __init__(
        self,
        scene: Scene,
        modules: Sequence[LampModule],
        camera: CameraParams,
        source: FaceSource,
        rate_hz: float,
        seed: int,
        device: torch.device,
        motion: Motion = STANDING,
        sensors: SensorParams = EXACT,
        disturbances: DisturbanceParams = UNDISTURBED,
    ) -> None:
        self.scene, self.modules, self.camera, self.source = scene, tuple(modules), camera, source
        self.period_s, self.seed, self.device = 1 / rate_hz, seed, device
        self.motion, self.sensors, self.disturbances = motion, sensors, disturbances
        self.moving = motion is not STANDING or scene.moves
        self.surfaces = surface_source(source, self.moving)
        self.view = camera_view(camera)
        beams = [module.beam for module in self.modules]
        self.beams = beams if any(bool(beam.u.any()) for beam in beams) else None
        self._lit: OrderedDict[Any, LitView] = OrderedDict()
        self._triangles = NOTHING

    def start(self) -> tuple[Frames | None, ...]:
        """As many missing frames as the camera is late."""
        return (None,) * self.camera.latency_steps

    def show(
        self, state: tuple[Frames | None, ...], lights: Sequence[Utilisation], step: int
    ) -> tuple[tuple[Frames | None, ...], Frames | None]:
        """Expose an on frame at the step's time and an off frame half a period later; what moves has moved in between."""
        on_view, off_view = (self.lit(t_s) for t_s in self.exposures(step))
        lit = added_light(on_view.transports, lights, on_view.base)
        on = self.exposed(lit, on_view.base, step, 0)
        off = self.exposed(off_view.off.expand(lit.shape), off_view.base, step, 1)
        queue = (*state, None if self._dropped(step) else (on, off))
        return queue[1:], queue[0]

    def exposures(self, step: int) -> tuple[float, float]:
        """Times in s of a step's on and off frame."""
        return step * self.period_s, (step + 0.5) * self.period_s

    def ego(self, step: int) -> Ego:
        """What the vehicle's sensors have said of its motion by a step."""
        return measured(self.motion, self.sensors, step, self.period_s, self.seed, self.view.T_world_view.float().to(self.device))

    def view_from_ground(self, t_s: float) -> View:
        """The camera's view at a time, in the ground frame in place of the world."""
        return replace(self.view, T_world_view=self.motion.at(t_s).T_ground_body @ self.view.T_world_view)

    def lit(self, t_s: float) -> LitView:
        """The camera's view of the scene at a time; rendered only when geometry or the vehicle has moved."""
        where = () if self.motion is STANDING else tuple(self.motion.at(t_s).T_world_body.flatten().tolist())
        key = (self.scene.key_at(t_s), where)
        if key not in self._lit:
            self._lit[key] = self._render(t_s)
            if len(self._lit) > KEPT_VIEWS:
                self._lit.popitem(last=False)
        self._lit.move_to_end(key)
        return self._lit[key]

    def _render(self, t_s: float) -> LitView:
        vehicle, samples = self.motion.at(t_s), self.camera.oversampling
        self._triangles = triangles = self.scene.at(t_s, vehicle.T_world_ground, self._triangles)
        view = camera_view(self.camera, samples)
        view = replace(view, T_world_view=vehicle.T_world_body @ view.T_world_view)
        surfaces = self.surfaces.gbuffer(triangles, view).to(self.device)
        spotlights = self.scene.spotlights_at(t_s)
        base = average_rows(ambient_luminance(surfaces, self.scene.ambient_lx, self.scene.street_lamps, spotlights), samples)
        return LitView(base, self.beams, lambda: self._transports(triangles, surfaces, vehicle.T_world_body))

    def _transports(self, triangles: Triangles, surfaces: GBuffer, T_world_body: Tensor) -> tuple[LightTransport, ...]:
        """A module's matrix is worth its making where the view stays for many steps."""
        samples, width = self.camera.oversampling, self.camera.width_px
        folded: list[LightTransport] = []
        for module in self.modules:
            headlight = module.headlight
            T_world_headlight = T_world_body.to(module.T_world_headlight) @ module.T_world_headlight
            if self.moving:
                folded.append(DirectTransport.of(surfaces, headlight, T_world_headlight, triangles, width, samples))
            else:
                folded.append(transport(reach(surfaces, headlight, T_world_headlight, triangles), headlight, width, samples))
        return tuple(folded)

    def exposed(self, luminance: Tensor, base: Tensor, step: int, frame: int) -> Tensor:
        """Digital numbers of a step's on frame (0) or off frame (1) of luminance `[..., height, width]` in cd/m^2, with what disturbs it.

        base: `[height, width]` cd/m^2, the part of the luminance that is there without the lamps.
        """
        ambient, noisy = self.disturbances.ambient_factor(step, frame), self.disturbances.noise_factor(step)
        if ambient != 1:
            luminance = luminance + (ambient - 1) * base
        t_s = self.exposures(step)[frame]
        for lamp in self.disturbances.oncoming_in(step, frame):
            view = replace(self.view, T_world_view=self.motion.at(t_s).T_world_body @ self.view.T_world_view)
            luminance = luminance + glare(view, lamp.position_at(t_s), lamp, self.device)
        generator = frame_generator(self.seed, step, frame, self.device)
        if noisy == 1:
            return expose(luminance, self.camera, generator)
        noise = torch.empty(luminance.shape, dtype=luminance.dtype, device=self.device).normal_(std=noisy, generator=generator)
        return expose(luminance, self.camera, noise)

    def _dropped(self, step: int) -> bool:
        p = self.disturbances.loss_probability(step, self.camera.drop_probability)
        return p > 0 and bool(np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(step, 2))).random() < p)
