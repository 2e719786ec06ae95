"""A scene in a view: what is true of it because it was rendered, and what the lamps do to it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from loop.lighting.lamps import ShiningModule
from perception.camera import CameraParams
from perception.detection.params import TruthParams
from perception.detection.protocol import Detections
from perception.ground_truth import Box, Truth, ground_truth, part_mask
from perception.materials import material_picture
from world.light.ambient import ambient_luminance
from world.light.illumination import LitSurface, illuminance, reach
from world.materials.library import MaterialName
from world.rendering.face_source import FaceSource
from world.rendering.gbuffer import GBuffer
from world.rendering.surfaces import surface_source
from world.scene.scene import Key, Scene
from world.scene.triangles import NOTHING, Triangles
from world.scene.vehicle import STANDING
from world.traffic.making import EYES
from world.traffic.objects import ObjectParams
from world.traffic.tracked import ROAD_USERS, Category
from world.view import View


@dataclass(frozen=True, eq=False)
class ModuleOnScene:
    """What a module reaches of the surfaces in a view, found when it first shines."""

    module: ShiningModule
    surfaces: GBuffer
    triangles: Triangles

    @cached_property
    def reached(self) -> LitSurface:
        """The surfaces in its light."""
        return reach(self.surfaces, self.module.headlight, self.module.T_world_module, self.triangles)


def categories(objects: Sequence[ObjectParams]) -> tuple[Category | None, ...]:
    """Classes of objects as a detector ought to name them: cars without a category, the parked ones, are cars."""
    return tuple("car" if each.category is None and each.kind == "car" else each.category for each in objects)


@dataclass(frozen=True, eq=False)
class LitScene:
    """A scene in a view at one time. base: luminance `[height, width]` in cd/m^2 without the lamps. given: its objects 1, 2, ..."""

    view: View
    triangles: Triangles
    surfaces: GBuffer
    base: Tensor
    modules: tuple[ModuleOnScene, ...]
    given: tuple[ObjectParams, ...]

    def light(self, lights: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Illuminance in lx and luminance in cd/m^2 `[height, width]` from the lamps alone, for utilisations `[n_p]`, one a module."""
        arriving = torch.zeros_like(self.base).flatten()
        leaving = torch.zeros_like(arriving)
        for each, u in zip(self.modules, lights, strict=True):
            if bool(u.any()):
                surface = each.reached
                lx = illuminance(surface, each.module.headlight.light_texture(u))
                arriving.index_add_(0, surface.index, lx)
                leaving.index_add_(0, surface.index, lx * surface.luminance_factor / math.pi)
        return arriving.view_as(self.base), leaving.view_as(self.base)

    @cached_property
    def objects(self) -> tuple[Truth, ...]:
        """Those with a class, of which a pixel is seen at least."""
        found = ground_truth(self.surfaces, self.triangles, self.view, categories(self.given))
        return tuple(each for each in found if each.category is not None)

    @cached_property
    def pixels(self) -> tuple[Tensor, ...]:
        """Flat indices of those at which each of the objects 1, 2, ... is seen."""
        ids = self.surfaces.object_id.flatten()
        seen = torch.nonzero(ids > 0)[:, 0]
        of_each = torch.bincount(ids[seen] - 1, minlength=len(self.given)).tolist()
        return seen[ids[seen].argsort(stable=True)].split(of_each)

    @cached_property
    def boxes(self) -> Tensor:
        """`[n, 4]` px of all of `objects`, whether hidden or not, as far as in the image."""
        return torch.tensor([self._inside(each.whole) for each in self.objects], dtype=torch.float64).view(-1, 4)

    @cached_property
    def eyes(self) -> Tensor:
        """Where the view sees heads and windscreens of road users, `[height, width]` bool."""
        users = torch.tensor([number for number, each in enumerate(self.given, 1) if each.category in ROAD_USERS], dtype=torch.int32)
        ids = self.surfaces.object_id
        return part_mask(self.surfaces, self.triangles, EYES) & torch.isin(ids, users.to(ids))

    @cached_property
    def materials(self) -> tuple[Tensor, tuple[MaterialName, ...]]:
        """Index `[height, width]` of what is seen in names of materials, -1 for none, and these."""
        return material_picture(self.surfaces, self.triangles)

    def detections(self, params: TruthParams, classes: tuple[Category, ...]) -> Detections:
        """What a detector finds that makes no mistakes."""
        height = self.boxes[:, 3] - self.boxes[:, 1]
        visible = torch.tensor([each.visible for each in self.objects], dtype=torch.float64)
        found = (height >= params.least_height_px) & (visible >= params.least_visible)
        numbers = torch.tensor([classes.index(each.category) for each in self.objects if each.category], dtype=torch.int64)
        scores = torch.nn.functional.one_hot(numbers, len(classes)).double()
        return Detections(self.boxes[found], scores[found])

    def _inside(self, box: Box) -> Box:
        width, height = self.view.width, self.view.height
        u0, u1 = (min(max(u, 0.0), width) for u in (box[0], box[2]))
        v0, v1 = (min(max(v, 0.0), height) for v in (box[1], box[3]))
        return u0, v0, u1, v1


class Looker:
    """Looks at a scene through one view; what has been rendered serves until something moves. given: parameters of the objects.

    before: see `Scene.at`.
    """

    def __init__(
        self,
        scene: Scene,
        view: View,
        modules: tuple[ShiningModule, ...],
        given: tuple[ObjectParams, ...],
        source: FaceSource,
        device: torch.device,
        before: Triangles = NOTHING,
    ) -> None:
        self.scene, self.view, self.modules, self.given, self.source, self.device = scene, view, modules, given, source, device
        self.surfaces = surface_source(source, scene.moves)
        self._time_s: float | None = None
        self._key: Key | None = None
        self._triangles = before
        self._lit: LitScene

    def through(self, view: View) -> "Looker":
        """The same scene through another view."""
        return Looker(self.scene, view, self.modules, self.given, self.source, self.device, self._triangles)

    def at(self, time_s: float) -> LitScene:
        """The scene at a time."""
        if time_s != self._time_s:
            key = self.scene.key_at(time_s)
            if key != self._key:
                triangles = self.scene.at(time_s, before=self._triangles)
                surfaces = self.surfaces.gbuffer(triangles, self.view).to(self.device)
                base = ambient_luminance(surfaces, self.scene.ambient_lx, self.scene.street_lamps, self.scene.spotlights_at(time_s))
                modules = tuple(ModuleOnScene(module, surfaces, triangles) for module in self.modules)
                self._key, self._triangles, self._lit = key, triangles, LitScene(self.view, triangles, surfaces, base, modules, self.given)
            self._time_s = time_s
        return self._lit


class Filmed:
    """A scene and its lamps as the world of a plant: what a camera on the car sees. What was lit last serves until other light is shown."""

    motion = STANDING

    def __init__(self, looker: Looker, camera: CameraParams) -> None:
        self.looker, self.camera, self.view, self.device = looker, camera, looker.view, looker.device
        self._last: tuple[float, tuple[Utilisation, ...], tuple[LitScene, Tensor, Tensor]] | None = None

    def lit(self, time_s: float, lights: tuple[Utilisation, ...]) -> tuple[LitScene, Tensor, Tensor]:
        """The scene at a time; illuminance in lx from the lamps alone and luminance in cd/m^2 of all light there, `[height, width]`."""
        if self._last is None or self._last[0] != time_s or self._last[1] is not lights:
            scene = self.looker.at(time_s)
            illuminance, luminance = scene.light([light.u for light in lights])
            self._last = (time_s, lights, (scene, illuminance, luminance + scene.base))
        return self._last[2]

    def luminance(self, time_s: float, lights: tuple[Utilisation, ...]) -> tuple[Tensor, Tensor]:
        """Luminances `[height, width]` in cd/m^2 at a time: of all light, and without the lamps."""
        scene, _, luminance = self.lit(time_s, lights)
        return luminance, scene.base

    def view_at(self, t_s: float) -> View:
        """The camera's view, which stands."""
        return self.view
