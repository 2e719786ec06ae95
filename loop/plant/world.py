"""The simulated world with a symbol's lamps, as its camera sees it."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from loop.assembly.truth import LampModule
from perception.camera import CameraParams, average_rows, camera_view
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


@dataclass(frozen=True, eq=False)
class LitView:
    """A scene as the camera sees it at one time.

    base: luminance `[height, width]` in cd/m^2 without the lamps. resting: utilisations of their base beams, one a module.
    transported: makes the transports, which are needed only where a lamp shines.
    """

    base: Tensor
    resting: Sequence[Utilisation]
    transported: Callable[[], tuple[LightTransport, ...]]

    @cached_property
    def transports(self) -> tuple[LightTransport, ...]:
        """Light transport, one a module."""
        return self.transported()

    @cached_property
    def off(self) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 with the base beams."""
        return added_light(self.transports, self.resting, self.base) if any(bool(light.u.any()) for light in self.resting) else self.base

    def shown(self, lights: Sequence[Utilisation]) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of all light, the lamps' lights `[..., n_p]` included."""
        if all(light is resting for light, resting in zip(lights, self.resting, strict=True)):
            return self.off
        return added_light(self.transports, lights, self.base)

    def luminance(self, lights: Sequence[Utilisation]) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of the symbol alone: on minus off, negative where it is darker than the base beams."""
        return added_light(self.transports, lights, self.base - self.off)


class World:
    """A scene, lamps and a camera on a vehicle; what has been rendered serves until something moves.

    moving: whether to render for a moving world; by default, whether scene or vehicle move.
    """

    def __init__(
        self,
        scene: Scene,
        modules: Sequence[LampModule],
        camera: CameraParams,
        source: FaceSource,
        device: torch.device,
        motion: Motion = STANDING,
        moving: bool | None = None,
    ) -> None:
        self.scene, self.modules, self.camera, self.source = scene, tuple(modules), camera, source
        self.device, self.motion = device, motion
        self.moving = (motion is not STANDING or scene.moves) if moving is None else moving
        self.surfaces = surface_source(source, self.moving)
        self.view = camera_view(camera)
        self.resting = tuple(module.beam for module in self.modules)
        self._lit: OrderedDict[Any, LitView] = OrderedDict()
        self._triangles = NOTHING

    def view_at(self, t_s: float) -> View:
        """The camera's view at a time."""
        return replace(self.view, T_world_view=self.motion.at(t_s).T_world_body @ self.view.T_world_view)

    def view_from_ground(self, t_s: float) -> View:
        """The camera's view at a time, in the ground frame in place of the world."""
        return replace(self.view, T_world_view=self.motion.at(t_s).T_ground_body @ self.view.T_world_view)

    def luminance(self, time_s: float, lights: tuple[Utilisation, ...]) -> tuple[Tensor, Tensor]:
        """Luminances in cd/m^2 at a time: `[..., height, width]` of all light, and `[height, width]` without the lamps."""
        lit = self.lit(time_s)
        return lit.shown(lights), lit.base

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
        return LitView(base, self.resting, lambda: self._transports(triangles, surfaces, vehicle.T_world_body))

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
