"""The simulated world: a scene, a vehicle with lamps and a camera, and the camera's view."""

import math
from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import TrackedObject
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import CameraParams, average_rows, camera_view
from luxloop.perception.detection.detector import Detections, TruthParams
from luxloop.perception.ground_truth import Box, GroundTruth, ground_truth, material_picture, part_mask, part_picture
from luxloop.world.caches import Part, PartialImage, keeping
from luxloop.world.frames import View, inverse
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import REST, Commands, ModuleCommand
from luxloop.world.light.backscatter import Backscatter
from luxloop.world.light.drops import drop_luminance
from luxloop.world.light.emitters import ambient_luminance, sun_luminance
from luxloop.world.light.illumination import DirectTransport, LightTransport, Shadows, added_light, lit_surface, transport
from luxloop.world.light.interreflection import Gathering, Interpolation, Interreflection
from luxloop.world.materials.library import MaterialName
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.rendering.raycast import sees
from luxloop.world.rendering.surfaces import FaceSource, SurfaceSource, surface_source
from luxloop.world.scene.air import Medium
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import NOTHING, Triangles
from luxloop.world.scene.vehicle import STANDING, Motion, VehicleState
from luxloop.world.traffic.models import MODELS
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.tracked import EYES, ROAD_USERS, Category

Photometry = tuple[Tensor | None, Tensor]  # illuminance in lx and luminance in cd/m^2
KEPT_VIEWS = 4  # on and off frame, before and after a change
KEPT_MEDIA = 4  # before and after a change of air, and of the drops that are drawn in it
KEPT_PARTS = 2  # image parts of a scene: around the symbols, around objects
KEPT_LIGHTS = 3  # exposures of a scene: on, off, and off without one symbol
MARGIN_PX = 1  # around objects, because OpenGL rounds their corners
DARK = Scene(())  # without light of its own
A_PIXEL: Part = (slice(0, 1), slice(0, 1))


def categories(objects: Sequence[ObjectParams]) -> tuple[Category | None, ...]:
    """Object classes that a detector should report; parked cars, which have no category, are of class "car"."""
    return tuple(each.category or _shape(each) for each in objects)


def _shape(each: ObjectParams) -> Category | None:
    """Class by the shape alone."""
    return MODELS[each.model][0] if each.kind == "model" else "car" if each.kind == "car" else None


@dataclass(eq=False)
class LitScene:
    """The scene at one time in one view, lit by the lamps; rendered at first use.

    eye: the whole view. part: rows and columns of the whole view, None for all. render: renders the surfaces of a part of a view.
    samples: rendered rows in a pixel. direct: whether each light is traced separately instead of by a transport matrix. given:
    parameters of the objects 1, 2, ... backscatter: of the lamps in the whole view, None in clear air. indirect: light that surfaces
    reflect onto each other, None for none.
    """

    time_s: float
    eye: View
    vehicle: VehicleState
    triangles: Triangles
    render: Callable[[Triangles, View, Part | None], GBuffer]
    scene: Scene
    modules: tuple[LampModule, ...]
    given: tuple[ObjectParams, ...]
    samples: int
    direct: bool
    backscatter: Backscatter | None = None
    indirect: "IndirectLight | None" = None
    part: Part | None = None

    def __post_init__(self) -> None:
        self._parts = dict[str, LitScene]()
        self._exposures = deque[tuple[tuple[Utilisation, ...], Commands, Photometry]](maxlen=KEPT_LIGHTS)
        self._turned = keeping(KEPT_VIEWS * len(self.modules), self._transport)
        self._shadows = keeping(KEPT_VIEWS * len(self.modules), self._shadows_of)

    @cached_property
    def view(self) -> View:
        """The view of the part."""
        return self.eye if self.part is None else self.eye.within(*self.part)

    @cached_property
    def rendered(self) -> GBuffer:
        """Surfaces with `samples` rows in each pixel."""
        part = self.part and (slice(self.samples * self.part[0].start, self.samples * self.part[0].stop), self.part[1])
        found = self.render(self.triangles, self.eye.with_rows(self.samples), part).to(self.modules[0].T_body_headlight.device)
        return found.in_air(self.scene.air_at(self.time_s), self.eye.origin)

    @cached_property
    def surfaces(self) -> GBuffer:
        """Surfaces at the pixel centres."""
        return self.rendered.one_row_of(self.samples)

    @property
    def is_rendered(self) -> bool:
        """Whether the surfaces have been rendered."""
        return not {"rendered", "transports"}.isdisjoint(vars(self))

    def within(self, part: Part) -> "LitScene":
        """A part of the whole view, rendered separately."""
        if part == self.eye.whole:
            return self
        if (key := str(part)) not in self._parts:
            self._parts = dict([*self._parts.items()][1 - KEPT_PARTS :]) | {key: replace(self, part=part)}
        return self._parts[key]

    @cached_property
    def base(self) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 without the lamps, of surfaces and air."""
        scene = self.scene
        spotlights = scene.spotlights_at(self.time_s)
        lit = ambient_luminance(self.rendered, scene.ambient_lx, scene.street_lamps, spotlights, scene.interreflection)
        if scene.sun is not None:
            lit = lit + sun_luminance(self.rendered, scene.sun, self.triangles, self.eye.origin)
        return average_rows(lit, self.samples)

    @cached_property
    def transports(self) -> tuple[LightTransport, ...]:
        """Light transport of each module at rest."""
        transports = tuple(self.transported(number, REST) for number in range(len(self.modules)))
        if not self.direct and self.base is not None and self.surfaces is not self.rendered:
            del self.rendered  # four times as large; a turned module renders it again
        return transports

    def transported(self, number: int, command: ModuleCommand) -> LightTransport:
        """Light transport of a turned module."""
        return self._turned(number, replace(command, intensity=1.0))  # dimming does not change the transport

    def _transport(self, number: int, command: ModuleCommand) -> LightTransport:
        module, width = self.modules[number], self.view.width
        T_body_headlight = command.turn(module.T_body_headlight)
        T_world_headlight = self.vehicle.T_world_body.to(T_body_headlight) @ T_body_headlight
        if not self.direct:
            surface = lit_surface(self.rendered, module.headlight, T_world_headlight, self.triangles)
            return transport(surface, module.headlight, width, self.samples)
        shadows = self._shadows(*T_world_headlight[:3, 3].tolist())
        return DirectTransport(self.rendered, module.headlight, T_world_headlight, shadows, width, self.samples, module.textures)

    def _shadows_of(self, *lamp_m: float) -> Shadows:
        return Shadows(self.rendered.position.flatten(1), torch.tensor(lamp_m, dtype=torch.float64), self.triangles)

    def at(self, surfaces: GBuffer) -> "LitScene":
        """The same light on other surfaces `[1, n]`, each traced separately."""
        eye = replace(self.eye, width=surfaces.albedo.numel(), height=1)
        return replace(self, eye=eye, render=lambda *_: surfaces, samples=1, part=None)

    def with_indirect(self) -> "LitScene":
        """The same scene, whose surfaces also light each other."""
        return replace(self, indirect=IndirectLight(self))

    @cached_property
    def _interpolation(self) -> Interpolation:
        assert self.indirect is not None
        return self.indirect.geometry.onto(self.surfaces)

    def reflected(self, lights: Sequence[Tensor], commands: Commands = ()) -> Tensor:
        """Illuminance `[..., height, width]` in lx at pixel centres by other surfaces in the light of the lamps; lights as of `light`."""
        assert self.indirect is not None
        return self._interpolation(self.indirect.on_points(commands, *lights))

    @cached_property
    def _matt(self) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 of surfaces in 1 lx, as of matt ones, less what the air takes."""
        haze = self.surfaces.haze
        return self.surfaces.albedo / math.pi * (1.0 if haze is None else haze.transmittance)

    def shown(self, lights: Sequence[Utilisation], commands: Commands = (), rows: slice | None = None) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of all light but backscatter. lights: utilisations `[..., n_p]`, one a module. rows:
        None for all.
        """
        if all(light.band is not None and light.band.stop <= light.band.start for light in lights):
            return self.base if rows is None else self.base[rows]
        if not commands:
            transports, dimmed = self.transports, tuple(lights)
        else:
            transports = tuple(self.transported(number, command) for number, command in enumerate(commands))
            dimmed = tuple(Utilisation(command.intensity * each.u, each.band) for each, command in zip(lights, commands, strict=True))
        direct = added_light(transports, dimmed, self.base, rows)
        if self.indirect is None:
            return direct
        added = self.reflected([light.u for light in lights], commands) * self._matt
        return direct + (added if rows is None else added[..., rows, :])

    def find_exposure(self, lights: tuple[Utilisation, ...], commands: Commands) -> Photometry | None:
        """Cached illuminance and luminance of a recent exposure, else None."""
        return next((found for shown, commanded, found in self._exposures if shown is lights and commanded == commands), None)

    def expose(self, lights: tuple[Utilisation, ...], commands: Commands, metered: bool) -> Photometry:
        """Illuminance in lx from the lamps alone, None unless metered, and luminance in cd/m^2 as of `shown`, `[height, width]`."""
        if (found := self.find_exposure(lights, commands)) is None:
            if metered:
                arriving, leaving = self.light([light.u for light in lights], commands)
                found = arriving, leaving + self.base
            else:
                found = None, self.shown(lights, commands)
            self._exposures.append((lights, commands, found))
        return found

    def luminance(self, lights: Sequence[Utilisation]) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of these lights alone, with all modules at rest."""
        direct = added_light(self.transports, lights, torch.zeros_like(self.base))
        return direct if self.indirect is None else direct + self.reflected([light.u for light in lights]) * self._matt

    def through_clear_air(self, luminance: Tensor) -> Tensor:
        """Luminance `[..., height, width]` of surfaces in the lamps' light, as it would be without extinction from lamps and to the eye."""
        if (haze := self.surfaces.haze) is None:
            return luminance
        T_world_body = self.vehicle.T_world_body
        lamps = torch.stack([(T_world_body @ each.T_body_headlight.to(T_world_body))[:3, 3] for each in self.modules]).mean(0)
        from_lamps = self.surfaces.position - lamps.to(self.surfaces.position)[:, None, None]
        transmittance = haze.transmittance * haze.medium.transmittance(from_lamps)
        return luminance / transmittance.where(transmittance > 0, 1.0)

    def light(self, lights: Sequence[Tensor], commands: Commands = ()) -> tuple[Tensor, Tensor]:
        """Illuminance in lx at pixel centres, and luminance in cd/m^2 of pixels, both `[height, width]`, from the lamps alone.

        lights: utilisations `[n_p]`, one a module. Requires `direct`.
        """
        arriving = torch.zeros_like(self.surfaces.albedo).flatten()
        leaving = torch.zeros_like(arriving)
        for number, (u, command) in enumerate(zip(lights, commands or (REST,) * len(lights), strict=True)):
            each = self.transported(number, command)
            assert isinstance(each, DirectTransport)
            lx, samples, factor = each.illuminance(u if command.intensity == 1 else command.intensity * u)
            pixels = each.pixel(samples)
            leaving.index_add_(0, pixels, each.reflect(lx, factor))
            arriving.index_add_(0, pixels, lx * each.central(samples))
        arriving, leaving = (each.view_as(self.surfaces.albedo) for each in (arriving, leaving))
        if self.indirect is None:
            return arriving, leaving
        reflected = self.reflected(lights, commands)
        return arriving + reflected, leaving + reflected * self._matt

    def backscattered(self, lights: Sequence[Utilisation], commands: Commands = (), part: Part | None = None) -> Tensor | float:
        """Luminance `[..., h, w]` in cd/m^2 of the lamps' light in the air, at a part of the whole view, None for all; 0.0 without any."""
        if self.backscatter is None:
            return 0.0
        lit = self.shining(lights, commands, of_texels=self.direct)  # direct light needs the textures, too
        return self.backscatter.luminance(lit, part or self.eye.whole, self.direct)

    def shining(self, lights: Sequence[Utilisation], commands: Commands, of_texels: bool) -> list[tuple[Headlight, Tensor, Tensor]]:
        """Modules that are not dark, as of `Backscatter.luminance`."""
        lit = list[tuple[Headlight, Tensor, Tensor]]()
        for module, light, command in zip(self.modules, lights, commands or (REST,) * len(lights), strict=True):
            if (light.band is None or light.band.start < light.band.stop) and bool(light.u.any()):
                u = light.u if command.intensity == 1 else command.intensity * light.u
                shown = module.textures.light_texture(u, light.band).flatten(-2) if of_texels else u
                lit.append((module.headlight, module.turned(command), shown))
        return lit

    @cached_property
    def objects(self) -> tuple[GroundTruth, ...]:
        """Objects with a class and at least one visible pixel."""
        found = ground_truth(self.surfaces, self.triangles, self.view, categories(self.given))
        return tuple(each for each in found if each.category is not None)

    @cached_property
    def boxes(self) -> Tensor:
        """Bounding boxes `[n, 4]` px of `objects`, hidden parts included, clipped to the image."""
        return torch.tensor([self._inside(each.whole) for each in self.objects], dtype=torch.float64).view(-1, 4)

    @cached_property
    def eyes(self) -> Tensor:
        """Pixels on heads and windscreens of road users, `[height, width]` bool."""
        users = torch.tensor([number for number, each in enumerate(self.given, 1) if each.category in ROAD_USERS], dtype=torch.int32)
        ids = self.surfaces.object_id
        return part_mask(self.surfaces, self.triangles, EYES) & torch.isin(ids, users.to(ids))

    @cached_property
    def materials(self) -> tuple[Tensor, tuple[MaterialName, ...]]:
        """Material index `[height, width]`, -1 for none, and the names of the materials."""
        return material_picture(self.surfaces, self.triangles)

    @cached_property
    def depth(self) -> Tensor:
        """Depth `[height, width]` m along the camera's axis at pixel centres, 0 without a surface."""
        T, position = self.view.T_world_view.to(self.surfaces.position), self.surfaces.position
        along = (T[:3, 2, None, None] * (position - T[:3, 3, None, None])).sum(0)
        return along.where(self.surfaces.object_id >= 0, 0 * along)

    def parts(self, names: Sequence[str]) -> Tensor:
        """Part index `[height, width]` in names, -1 for none of them."""
        return part_picture(self.surfaces, self.triangles, names)

    def detections(self, params: TruthParams, classes: tuple[Category, ...]) -> Detections:
        """Detections of a perfect detector."""
        height = self.boxes[:, 3] - self.boxes[:, 1]
        visible = torch.tensor([each.visible for each in self.objects], dtype=torch.float64)
        found = (height >= params.least_height_px) & (visible >= params.least_visible)
        numbers = torch.tensor([classes.index(each.category) for each in self.objects if each.category], dtype=torch.int64)
        scores = torch.nn.functional.one_hot(numbers, len(classes)).double()
        return Detections(self.boxes[found], scores[found])

    @property
    def around_objects(self) -> Part:
        """Image part that contains all objects, at least one pixel; the whole image if an object reaches behind the camera."""
        boxes = [placed.box.T for placed in self.triangles.placed if placed.object_id > 0]
        if not boxes:
            return A_PIXEL
        corners, depth = self.eye.project(torch.stack(boxes))  # [n, 2, 8], [n, 8]
        ahead, size = (depth > 0)[:, None], corners.new_tensor([self.eye.width, self.eye.height])
        crossing = ahead.any(-1) & ~ahead.all(-1)
        low = torch.where(crossing, 0.0, corners.amin(-1).floor() - MARGIN_PX).clamp(min=0)  # [n, 2]
        high = torch.where(crossing, size, corners.amax(-1).ceil() + MARGIN_PX).minimum(size)
        seen = ahead.any(-1)[:, 0] & (low < high).all(-1)
        if not bool(seen.any()):
            return A_PIXEL
        (left, top), (right, bottom) = low[seen].amin(0).int().tolist(), high[seen].amax(0).int().tolist()
        return slice(top, bottom), slice(left, right)

    def _inside(self, box: Box) -> Box:
        width, height = self.view.width, self.view.height
        u0, u1 = (min(max(u, 0.0), width) for u in (box[0], box[2]))
        v0, v1 = (min(max(v, 0.0), height) for v in (box[1], box[3]))
        return u0, v0, u1, v1


@dataclass(eq=False)
class IndirectLight:
    """Light of the lamps that surfaces reflect onto each other, for all parts of a view. lit: the whole view in direct light."""

    lit: LitScene

    def __post_init__(self) -> None:
        self.on_points = keeping(KEPT_LIGHTS, self._on_points)

    @cached_property
    def geometry(self) -> Interreflection:
        """Points on the surfaces, and what they see."""
        T_world_body = self.lit.vehicle.T_world_body
        lamps_m = [(T_world_body @ each.T_body_headlight.double().cpu())[:3, 3] for each in self.lit.modules]
        return Interreflection(self.lit.triangles, self.lit.eye, torch.stack(lamps_m))

    @cached_property
    def _reflectors(self) -> tuple[tuple[Gathering, LitScene, slice], ...]:
        """Surfaces that light others, and the modules that light them."""
        some = [slice(None), *(slice(number, number + 1) for number in range(len(self.lit.modules)))]
        return tuple(
            (each, replace(self.lit.at(each.surfaces), scene=DARK, modules=self.lit.modules[which]), which)
            for each, which in zip(self.geometry.gatherings, some, strict=False)
        )

    def _on_points(self, commands: Commands, *lights: Tensor) -> Tensor:
        """Illuminance `[..., N]` in lx of the points."""
        total: Tensor | float = 0.0
        for gathering, lit, some in self._reflectors:
            leaving = lit.shown([Utilisation(u) for u in lights[some]], commands[some]).flatten(-2)
            total = total + gathering.illuminance(leaving, self.geometry.points[0].shape[1])
        return torch.as_tensor(total)


@dataclass(frozen=True, eq=False)
class ObjectLight:
    """Illuminance from the lamps at the centres of the m pixels on objects.

    numbers: `[m]`, numbers of the objects 1, 2, ... eyes: `[m]` bool, whether a head or windscreen is in the pixel. lx: `[m]`.
    """

    numbers: Tensor
    eyes: Tensor
    lx: Tensor

    def on(self, number: int) -> Tensor:
        """Illuminance in lx on an object."""
        return self.lx[self.numbers == number]

    def on_eyes(self, numbers: Collection[int]) -> Tensor:
        """Illuminance in lx on heads and windscreens of these objects."""
        return self.lx[self.eyes & torch.isin(self.numbers, torch.tensor([*numbers]).to(self.numbers))]


@dataclass(frozen=True, eq=False)
class TrueObject:
    """An object present in the world.

    instance: index in the world's `instances`. category: from the scenario. boxed: box in the world frame. seen: ground truth in the
    camera's view, None without a visible pixel or a class.
    """

    name: str
    instance: int
    category: Category | None
    boxed: TrackedObject
    seen: GroundTruth | None


class World:
    """A scene and a vehicle with lamps and a camera; rendered views are reused until something moves.

    metered: whether illuminance is computed with each luminance. given: parameters of the scene's objects.
    """

    def __init__(
        self,
        scene: Scene,
        modules: Sequence[LampModule],
        camera: CameraParams,
        source: FaceSource,
        motion: Motion = STANDING,
        metered: bool = False,
        given: tuple[ObjectParams, ...] = (),
    ) -> None:
        self.scene, self.modules, self.camera, self.source = scene, tuple(modules), camera, source
        self.motion, self.metered, self.given = motion, metered, given
        self.moving = scene.moves or not motion.stands
        self.view = camera_view(camera)
        self.device = self.modules[0].T_body_headlight.device
        self._lit: OrderedDict[Any, LitScene] = OrderedDict()
        self._backscatter = keeping(KEPT_MEDIA, self._backscatter_of)
        self._triangles = NOTHING  # the newest; bodies that have not moved are reused

    @cached_property
    def surfaces(self) -> SurfaceSource:
        """Renders the surfaces of views."""
        return surface_source(self.source, self.moving)

    def after(self, before: "World | None") -> Self:
        """This world, reusing geometry and renderer of an earlier one."""
        if before is not None:
            self._triangles = before._triangles
            if (before.source, before.moving) == (self.source, self.moving):
                self.surfaces = before.surfaces
        return self

    def view_at(self, t_s: float) -> View:
        """The camera's view in the world frame at a time."""
        return replace(self.view, T_world_view=self.motion.at(t_s).T_world_body @ self.view.T_world_view)

    def sees(self, point: Tensor, t_s: float) -> bool:
        """Whether the camera sees a point `[3]` m of the world at a time, if it is in the image."""
        return bool(sees(self.lit(t_s).triangles, self.view_at(t_s).origin, point[:, None]))

    def view_from_ground(self, t_s: float) -> View:
        """The camera's view in the ground frame at a time."""
        return replace(self.view, T_world_view=self.motion.at(t_s).T_ground_body @ self.view.T_world_view)

    def luminance(
        self, time_s: float, lights: tuple[Utilisation, ...], commands: Commands = (), part: Part | None = None
    ) -> tuple[Tensor, Tensor]:
        """Luminances in cd/m^2 at a time: of all light, `[..., height, width]`, and without the lamps, `[height, width]`.

        part: rows and columns of the image, None for all.
        """
        found, base = self._without_backscatter(time_s, lights, commands, part)
        lit = self.lit(time_s)
        return found if lit.backscatter is None else found + lit.backscattered(lights, commands, part), base

    def drops(self, time_s: float, lights: tuple[Utilisation, ...], commands: Commands, random: np.random.Generator) -> Tensor | None:
        """Luminance `[height, width]` in cd/m^2 by which single drops and flakes near the camera differ from their mean during an exposure
        that begins at a time; None without any.
        """
        medium = self.scene.air_at(time_s)
        if medium is None or not medium.falling:
            return None
        lit, exposure_s = self.lit(time_s).shining(lights, commands, of_texels=True), self.camera.exposure_s
        begin, end = (self.motion.at(each).T_world_body for each in (time_s, time_s + exposure_s))
        later = replace(self.view, T_world_view=inverse(begin) @ end @ self.view.T_world_view)
        drawn = drop_luminance(medium, self.view, later, exposure_s, lit, random).to(self.device)
        return drawn - self._backscatter(replace(medium, drawn_only=True)).luminance(lit, self.view.whole, of_texels=True)

    def _without_backscatter(
        self, time_s: float, lights: tuple[Utilisation, ...], commands: Commands, part: Part | None = None
    ) -> tuple[Tensor, Tensor]:
        """As `luminance`, without the lamps' light in the air."""
        lit = self.lit(time_s)
        if part is not None and self.moving and not lit.is_rendered:  # of a standing scene, parts are cut from the whole, which lasts
            lit, part = lit.within(part), None
        if part is None:
            return lit.expose(lights, commands, self.metered)[1], lit.base
        if self.metered or self.moving or lit.find_exposure(lights, commands):
            return lit.expose(lights, commands, self.metered)[1][..., *part], lit.base[part]
        return lit.shown(lights, commands, part[0])[..., part[1]], lit.base[part]

    def image(self, like: Tensor, part_of: Callable[[Part], Tensor]) -> PartialImage:
        """A camera image `[height, width]`, computed on access. like: gives dtype and device."""
        return PartialImage.of(self.view.height, self.view.width, like[:0], part_of)

    def on_objects(self, time_s: float, lights: tuple[Utilisation, ...], commands: Commands = ()) -> ObjectLight:
        """Illuminance from the lamps on all objects at a time, computed at their pixels only."""
        lit = self.lit(time_s)
        seen = lit if lit.is_rendered or not self.moving else lit.within(lit.around_objects)
        pixels = torch.nonzero(seen.surfaces.object_id.flatten() > 0)[:, 0]
        surfaces = seen.surfaces.at(pixels)
        if (known := seen.find_exposure(lights, commands)) and known[0] is not None:
            lx = known[0].flatten()[pixels]
        else:
            lx = replace(lit.at(surfaces), direct=True).light([light.u for light in lights], commands)[0][0]
        return ObjectLight(surfaces.object_id[0], part_mask(surfaces, lit.triangles, EYES)[0], lx)

    def added(self, time_s: float, lights: tuple[Utilisation, ...], others: tuple[Utilisation, ...], commands: Commands = ()) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 of surfaces in these lights minus that in others, at a time, as seen in clear air."""
        on, off = (self._without_backscatter(time_s, each, commands)[0] for each in (lights, others))
        return self.lit(time_s).through_clear_air(on - off)

    def illuminance(self, time_s: float, lights: tuple[Utilisation, ...], commands: Commands = ()) -> Tensor:
        """Illuminance `[height, width]` lx from the lamps alone at pixel centres, at a time; also if the world is not metered."""
        if self.metered and (lx := self.lit(time_s).expose(lights, commands, metered=True)[0]) is not None:
            return lx
        return self.lit(time_s, direct=True).light([light.u for light in lights], commands)[0]

    def lit(self, t_s: float, direct: bool = False) -> LitScene:
        """The scene in the camera's view at a time, reused while neither geometry nor vehicle moves.

        direct: whether illuminance is needed.
        """
        vehicle, direct = self.motion.at(t_s), direct or self.moving or self.metered
        where = () if self.motion is STANDING else tuple(vehicle.T_world_body.flatten().tolist())
        medium = self.scene.air_at(t_s)
        key = self.scene.key_at(t_s), where, direct, medium
        if key not in self._lit:
            self._triangles = triangles = self.scene.at(t_s, vehicle.T_world_ground, self._triangles)
            eye, render, parts = self.view_at(t_s), self.surfaces.gbuffer, (self.scene, self.modules, self.given)
            backscatter = None if medium is None else self._backscatter(medium)
            lit = LitScene(t_s, eye, vehicle, triangles, render, *parts, self.camera.oversampling, direct, backscatter)
            self._lit[key] = lit.with_indirect() if self.scene.interreflection else lit
            if len(self._lit) > KEPT_VIEWS:
                self._lit.popitem(last=False)
        self._lit.move_to_end(key)
        return self._lit[key]

    def _backscatter_of(self, medium: Medium) -> Backscatter:
        return Backscatter(medium, self.view)

    @property
    def instances(self) -> tuple[str, ...]:
        """Names by `object_id + 1` of a surface: none, the road, and the objects."""
        return "", "road", *(each.name for each in self.scene.objects)

    def objects_at(self, t_s: float) -> tuple[TrueObject, ...]:
        """All objects present at a time, in the order of `instances`."""
        lit = self.lit(t_s)
        there, seen = {each.object_id for each in lit.triangles.placed}, {each.object_id: each for each in lit.objects}
        return tuple(
            TrueObject(body.name, number + 1, given.category, TrackedObject.of(body, given.category or "car", t_s), seen.get(number))
            for number, (body, given) in enumerate(zip(self.scene.objects, self.given, strict=True), 1)
            if number in there
        )

    def through(self, view: View, t_s: float) -> LitScene:
        """The scene at a time in another view. view: in the ground frame of that time."""
        lit = self.lit(t_s)
        eye = replace(view, T_world_view=self.motion.at(t_s).T_world_ground @ view.T_world_view)
        from_body = replace(eye, T_world_view=inverse(lit.vehicle.T_world_body) @ eye.T_world_view)
        backscatter = lit.backscatter and Backscatter(lit.backscatter.medium, from_body)
        seen = replace(lit, eye=eye, samples=1, direct=True, backscatter=backscatter, indirect=None)
        return seen if lit.indirect is None else seen.with_indirect()
