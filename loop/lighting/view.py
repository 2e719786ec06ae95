"""What the lamps do to a view of the scene: the light that arrives, and how bright it looks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from loop.lighting.lamps import ShiningModule
from world.light.ambient import ambient_luminance
from world.light.illumination import LitSurface, illuminance, reach
from world.rendering.face_source import FaceSource
from world.rendering.gbuffer import GBuffer
from world.rendering.surfaces import surface_source
from world.scene.scene import Key, Scene
from world.scene.triangles import Triangles
from world.view import View


@dataclass(frozen=True, eq=False)
class LitScene:
    """A scene in a view at one time. base: luminance `[height, width]` in cd/m^2 without the lamps."""

    view: View
    triangles: Triangles
    surfaces: GBuffer
    base: Tensor
    modules: tuple[ShiningModule, ...]
    _reached: dict[int, LitSurface] = field(default_factory=dict, init=False, repr=False)

    def light(self, lights: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Illuminance in lx and luminance in cd/m^2 `[height, width]` from the lamps alone, for utilisations `[n_p]`, one a module."""
        arriving = torch.zeros_like(self.base).flatten()
        leaving = torch.zeros_like(arriving)
        for number, (module, u) in enumerate(zip(self.modules, lights, strict=True)):
            if bool(u.any()):
                surface, texture = self._surface(number), module.headlight.light_texture(u)
                lx = illuminance(surface, texture)
                arriving.index_add_(0, surface.index, lx)
                leaving.index_add_(0, surface.index, lx * surface.luminance_factor / math.pi)
        return arriving.view_as(self.base), leaving.view_as(self.base)

    def _surface(self, number: int) -> LitSurface:
        if number not in self._reached:
            module = self.modules[number]
            self._reached[number] = reach(self.surfaces, module.headlight, module.T_world_module, self.triangles)
        return self._reached[number]


class Looker:
    """Looks at a scene through one view; what has been rendered serves until something moves."""

    def __init__(self, scene: Scene, view: View, modules: tuple[ShiningModule, ...], source: FaceSource, device: torch.device) -> None:
        self.scene, self.view, self.modules, self.source, self.device = scene, view, modules, source, device
        self.surfaces = surface_source(source, scene.moves)
        self._time_s: float | None = None
        self._key: Key | None = None
        self._lit: LitScene

    def at(self, time_s: float) -> LitScene:
        """The scene at a time."""
        if time_s != self._time_s:
            key = self.scene.key_at(time_s)
            if key != self._key:
                triangles = self.scene.at(time_s)
                surfaces = self.surfaces.gbuffer(triangles, self.view).to(self.device)
                base = ambient_luminance(surfaces, self.scene.ambient_lx, self.scene.street_lamps, self.scene.spotlights_at(time_s))
                self._key, self._lit = key, LitScene(self.view, triangles, surfaces, base, self.modules)
            self._time_s = time_s
        return self._lit
