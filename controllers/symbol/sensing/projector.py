"""The projector (T 9.4.1) draws one symbol with one or several lamp modules: a pose in, utilisations out."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.pixels.primitives import Primitives, Quantity, road_symbol
from luxloop.controllers.pixels.ssc import PixelController, Utilisation
from luxloop.controllers.pixels.windows import union
from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.road_shape import (
    below_lamps,
    bounding_rectangle,
    cells_of_rectangle,
    pose_of_rectangle,
    ray_lengths,
)
from luxloop.perception import appearance
from luxloop.world.caches import keeping
from luxloop.world.frames import View, inverse, pose, rotation, transform
from luxloop.world.params import Params
from luxloop.world.texels import NOWHERE, Window, resample

FOLLOWED = 4  # light paths are traced for every fourth cell along and across, and interpolated
FARTHEST, NO_ROAD = 3.0, 1e3  # ends of rays that meet no road: lines of sight in distances to z = 0, light in distances to the patch
LEAST_FALL_M = 1e-3  # least height of a ray's origin above the plane


def lift(
    projection: ProjectionCommand, size_m: tuple[float, float], shape: Tensor, x0_m: float, eye: Tensor, lamps: Tensor
) -> ProjectionCommand:
    """The command on a rectangle tangent to a road of shape `[4]` about x0, for a command on the plane z = 0; size_m: length, width.

    eye: `[3]`, lamps: `[m, 3]` m. The eye sees the same image of both commands; each lamp has its own warp.
    """
    length, width = size_m if projection.warp is None else projection.warp.size_m
    T = _rectangle(projection)
    corners = lamps.new_tensor([[length, length, -length, -length], [width, -width, width, -width], [0.0] * 4]) / 2
    ways = torch.stack([_crossed(lamp, transform(T, corners)) for lamp in lamps], 1) - eye[:, None, None]  # [3, m, 4]
    road = eye[:, None, None] + ways * ray_lengths(shape[None], x0_m, eye, ways)[0].clamp(max=FARTHEST)
    patch, size = _patch(road, shape, x0_m, lamps)
    count = CELLS[0] // FOLLOWED, CELLS[1] // FOLLOWED
    cells = cells_of_rectangle(size, count, lamps).flatten(1)
    places = []
    for lamp in lamps:
        ways = transform(patch, cells) - lamp[:, None]
        road = lamp[:, None] + ways * ray_lengths(shape[None], x0_m, lamp, ways)[0].clamp(max=NO_ROAD)
        lamp_there, seen = (transform(inverse(T), points) for points in (lamp[:, None], _crossed(eye, road)))
        x_there, y_there, _ = _crossed(lamp_there[:, 0], seen)
        places.append(torch.stack([-2 * y_there / width, -2 * x_there / length]).view(2, *count))
    source = interpolate(torch.stack(places), scale_factor=FOLLOWED, mode="bilinear")
    return ProjectionCommand(*pose_of_rectangle(patch), _compose_warps(projection.warp, source, size))


def _rectangle(projection: ProjectionCommand) -> Tensor:
    """Pose `[4, 4]` of a projection's rectangle."""
    x, y, *angles = projection.pose
    z = torch.zeros_like(x) if projection.z is None else projection.z
    return pose(torch.stack([x, y, z]), rotation(*angles))


def _crossed(origin: Tensor, points: Tensor) -> Tensor:
    """Intersections with z = 0 of rays from an origin `[3]` m through points `[3, ...]` m; far ahead for rays that do not fall."""
    start = origin.view(3, *(1,) * (points.dim() - 1))
    return start + (points - start) * (origin[2] / (origin[2] - points[2]).clamp(min=LEAST_FALL_M))


def _patch(road: Tensor, shape: Tensor, x0_m: float, lamps: Tensor) -> tuple[Tensor, tuple[float, float]]:
    """Pose `[4, 4]`, length and width in m of a rectangle that all light of m lamps to points `[3, m, k]` of the road crosses.

    The rectangle is tangent to the road at the points' mean, or less steep if needed so that the lamps light it.
    """
    _, b, c, d = shape
    middle = road.flatten(1).mean(1)
    T = below_lamps(middle, b + d * (middle[0] - x0_m), c, lamps)
    local, origins = transform(inverse(T), road.flatten(1)).view_as(road), transform(inverse(T), lamps.T).T
    crossings = torch.stack([_crossed(origin, points)[:2] for origin, points in zip(origins, local.unbind(1), strict=True)], 1)
    low, high = crossings.flatten(1).aminmax(dim=1)
    return bounding_rectangle(T, low, high)


def _compose_warps(warp: Warp | None, source: Tensor, size_m: tuple[float, float]) -> Warp:
    """The composition of a warp, or none, with a second warp whose cells have coordinates `[m, 2, h, w]` on the rectangle of the first."""
    if warp is None:
        return Warp(source, torch.ones_like(source[:, 0]), size_m)
    u, v = source.unbind(1)
    of, dimming = (each.expand(len(u), -1, -1, -1) for each in (warp.source, warp.dimming[:, None]))
    taken = resample(of, u, v, "border")
    dimmed = resample(dimming, u, v)
    return Warp(taken, dimmed[:, 0], size_m)


CORNERS = 4  # of a rectangle
AHEAD_M = 0.1  # least distance from the camera of visible points


class SymbolParams(Params):
    """The symbol, its size and brightness, and its target on the assumed road."""

    image: str = Field(description="name of a shipped symbol, or path of a picture or SVG: white is light, top is the far end")
    width_m: float = Field(2.0, gt=0, le=20, description="extent across the road")
    length_m: float = Field(4.0, gt=0, le=50, description="extent along the road")
    x_m: float = Field(17.0, gt=1, le=100, description="target position of the centre ahead of the lamps")
    y_m: float = Field(0.0, ge=-20, le=20, description="target position of the centre to the left")
    target: Literal["appearance", "place"] = Field(
        "appearance", description="quantity held at x_m, y_m: the symbol's appearance on a flat road, or its place on the road"
    )
    quantity: Quantity = Field(
        "u_abs", description="unit of the setpoint: I_v in cd, E_v in lx, u_abs as a share, u_rel as a multiple of the base beam"
    )
    value: float = Field(
        1.0, gt=0, le=1e9, description="setpoint of a white pixel of the image; all but u_rel share it evenly among their modules"
    )


class StartParams(Params):
    """Pose of the symbol's primitive at step 0."""

    x_m: float = Field(17.0, gt=1, le=100, description="centre ahead of the lamps")
    y_m: float = Field(0.0, ge=-20, le=20, description="centre to the left")
    roll_deg: float = Field(0.0, ge=-45, le=45, description="rotation about the forward axis")
    pitch_deg: float = Field(0.0, ge=-45, le=45, description="rotation about the left axis, nose down positive")

    @property
    def pose(self) -> Tensor:
        """`[n]` = x, y in m, roll, pitch in rad."""
        values = torch.tensor([getattr(self, degree.key) for degree in appearance.DEGREES])
        return torch.cat([values[:2], torch.deg2rad(values[2:])])


@dataclass(frozen=True)
class DrawingModule:
    """A lamp module that draws: its pixel controller and its pose `T_body_headlight` `[4, 4]`."""

    name: str
    pixel_controller: PixelController
    T_body_headlight: Tensor

    @cached_property
    def borders(self) -> Tensor:
        """Planes `[4, 4]` through the left, right, top and bottom borders of its field: normals outwards, and their distances in m."""
        light, T = self.pixel_controller.headlight, self.T_body_headlight.double()
        sides = [[-light.left, 1, 0], [light.right, -1, 0], [-light.top, 0, 1], [light.bottom, 0, -1]]
        normals = T.new_tensor(sides) @ T[:3, :3].T
        return torch.cat([normals, -normals @ T[:3, 3:]], 1)


@dataclass(frozen=True)
class Projector:
    """Draws one symbol with lamp modules.

    modules: the drawing modules. symbol: image `[h, w]` in 0..1. params: size, brightness and target. eye: `[3]` m in the body frame, the
    camera for which road shapes are compensated. observer: `[3]` m in the ground frame, the eye that is to see the symbol on the road as
    on the plane z = 0; None: the target decides.
    """

    modules: tuple[DrawingModule, ...]
    symbol: Tensor
    params: SymbolParams
    eye: Tensor
    observer: Tensor | None = None

    @property
    def target(self) -> Tensor:
        """The pose on the assumed flat road, `[n]` = x, y in m, roll, pitch in rad."""
        return self.symbol.new_tensor([self.params.x_m, self.params.y_m, *[0.0] * (len(appearance.DEGREES) - 2)])

    @cached_property
    def resting(self) -> tuple[Utilisation, ...]:
        """Utilisations `[n_p]` of the base beams, one a module: the light without the symbol."""
        return tuple(Utilisation(module.pixel_controller.default) for module in self.modules)

    def primitive(self, pose: Tensor) -> Primitives:
        """The symbol's primitive for a pose `[..., 4]` (x, y in m, roll, pitch in rad)."""
        return self._rectangle(pose, self.params.length_m, self.params.width_m, self.symbol)

    def _rectangle(self, pose: Tensor, length_m: float, width_m: float, image: Tensor) -> Primitives:
        p = self.params
        value = p.value if p.quantity == "u_rel" else p.value / len(self.modules)
        return road_symbol(pose, 0.0, width_m, length_m, image, value, p.quantity)

    @cached_property
    def _cached_rectangle(self) -> Callable[[ProjectionCommand], Primitives]:
        return keeping(2, self._rectangle_of)  # the projection drawn now and the projection in the newest frames

    def rectangle(self, projection: ProjectionCommand) -> Primitives:
        """The primitive of a projection's rectangle with the undistorted symbol; cached for the newest projections without gradient."""
        learns = projection.pose.requires_grad or (projection.z is not None and projection.z.requires_grad)
        return (self._rectangle_of if learns else self._cached_rectangle)(projection)

    def _rectangle_of(self, projection: ProjectionCommand) -> Primitives:
        projection = self.on_road(projection)
        size = (self.params.length_m, self.params.width_m) if projection.warp is None else projection.warp.size_m
        return _raise(self._rectangle(projection.pose, *size, self.symbol), projection.z)

    def light(self, pose: Tensor) -> tuple[Utilisation, ...]:
        """Utilisations `[..., n_p]`, one a module, that draw the undistorted symbol at a pose `[..., 4]`."""
        return self._cast([self.primitive(pose)] * len(self.modules))

    def draw(self, projection: ProjectionCommand) -> tuple[Utilisation, ...]:
        """Utilisations `[..., n_p]`, one a module, of a projection; a warped batch is drawn one by one."""
        if projection.raw is not None:
            return tuple(Utilisation(u) for u in projection.raw)
        projection = self.on_road(projection)
        if projection.warp is None:
            return self._cast(self.primitives(projection))
        batch = projection.pose.shape[:-1]
        singles = [self._cast(self.primitives(each)) for each in projection.singles()]
        return tuple(
            Utilisation(torch.stack([light.u for light in lights]).unflatten(0, batch)) if batch else lights[0]
            for lights in zip(*singles, strict=True)
        )

    def primitives(self, projection: ProjectionCommand, clear: bool = False) -> Sequence[Primitives]:
        """The primitive of each module for a projection without raw utilisations; no batch if warped.

        clear: whether a warp's cells beyond the symbol are transparent instead of dark.
        """
        projection = self.on_road(projection)
        if projection.warp is None:
            return [self.rectangle(projection)] * len(self.modules)
        u, v = projection.warp.source.unbind(1)
        symbol = self.symbol.expand(len(u), 1, -1, -1)
        warped = resample(symbol, u, v)[:, 0] * projection.warp.dimming
        if clear:
            warped = torch.stack([warped, (projection.warp.source.abs().amax(1) <= 1).to(warped)], 1)
        images = warped.expand(len(self.modules), *warped.shape[1:])
        return [_raise(self._rectangle(projection.pose, *projection.warp.size_m, image), projection.z) for image in images]

    def on_road(self, projection: ProjectionCommand) -> ProjectionCommand:
        """The command on the rectangle tangent to the road of the projection's shape; unchanged for z = 0."""
        if projection.shape is None:
            return projection
        p, lamps = self.params, torch.stack([module.T_body_headlight[:3, 3] for module in self.modules]).to(self.symbol)
        return lift(projection, (p.length_m, p.width_m), projection.shape, p.x_m, self.eye.to(self.symbol), lamps)

    def _cast(self, primitives: Iterable[Primitives]) -> tuple[Utilisation, ...]:
        """Utilisations of one primitive a module."""
        return tuple(
            module.pixel_controller.utilisation(primitive, module.T_body_headlight)
            for module, primitive in zip(self.modules, primitives, strict=True)
        )

    def textures(self, lights: Sequence[Utilisation]) -> tuple[Tensor, ...]:
        """Light textures `[rows, cols]` in cd, one a module, of lights `[n_p]` minus the base beams."""
        return tuple(_texture(module.pixel_controller, light) for module, light in zip(self.modules, lights, strict=True))

    def footprint(self, projection: ProjectionCommand, view: View, margin_m: float, shape: Tensor | None = None) -> Window:
        """The window of a camera's image in which the light of a projection, or of all projections of a batch, can appear.

        margin_m: largest height of the road above or below its shape. shape: `[4]` of the road, see
        `luxloop.controllers.symbol.sensing.road_shape`; default: z = 0. Rays that do not meet the road within 200 m end there.
        """
        return union(self.footprints(projection, view, margin_m, shape))

    def footprints(self, projection: ProjectionCommand, view: View, margin_m: float, shape: Tensor | None = None) -> list[Window]:
        """The footprint of each projection of a batch."""
        corners = self.rectangle(projection).corners().detach().reshape(-1, 3).T.cpu().double().numpy()
        origins = np.stack([module.T_body_headlight[:3, 3:].double().cpu().numpy() for module in self.modules])
        rays, heights = corners - origins, np.array([-margin_m, margin_m])  # [m, 3, N], [2]
        if shape is None:
            with np.errstate(divide="ignore", invalid="ignore"):
                reach = (heights[:, None, None] - origins[:, 2]) / rays[:, 2]  # [2, m, N]
            reach = np.where((rays[:, 2] < 0) & (reach > 0), reach, np.inf)
        else:
            bounds = shape.detach().cpu().double() + torch.nn.functional.pad(torch.from_numpy(heights)[:, None], (0, 3))
            both = zip(torch.from_numpy(origins[..., 0]), torch.from_numpy(rays), strict=True)
            reach = torch.stack([ray_lengths(bounds, self.params.x_m, *each) for each in both], 1).numpy()
        ends = origins + rays * np.minimum(reach, 200 / np.linalg.norm(rays, axis=1))[:, :, None]  # [2, m, 3, N]
        uv, depth = view.project_few(np.moveaxis(ends, 2, 0).reshape(3, -1))
        size = (2 * len(self.modules), corners.shape[1] // CORNERS, CORNERS)
        uv, there = uv.reshape(2, *size), (depth > AHEAD_M).reshape(size)
        low, high = np.where(there, uv, np.inf).min((1, 3)).T, np.where(there, uv, -np.inf).max((1, 3)).T
        seen: list[bool] = np.any(there, (0, 2)).tolist()
        return [_window(*each, view) if some else NOWHERE for each, some in zip(zip(low, high, strict=True), seen, strict=True)]


def _texture(controller: PixelController, light: Utilisation) -> Tensor:
    """Light texture `[rows, cols]` in cd of a light `[n_p]` minus the base beam."""
    added, band = light.u - controller.default, light.band
    if controller.default.any():
        lit = added.nonzero()[[0, -1], 0].tolist() if added.any() else [0, -1]
        band = slice(lit[0], lit[1] + 1)
    return controller.headlight.light_texture(added, band)


def _window(low: Iterable[float], high: Iterable[float], view: View) -> Window:
    """The window of all pixels between two corners (u, v) in px, clipped to the image."""
    whole = (view.width, view.height)
    u0, v0 = (min(max(math.floor(end), 0), n) for end, n in zip(low, whole, strict=True))
    u1, v1 = (min(max(math.ceil(end), 0), n) for end, n in zip(high, whole, strict=True))
    return Window(v0, v1, u0, u1)


def _raise(primitive: Primitives, z: Tensor | None) -> Primitives:
    """A primitive `[..., 1]` raised by z `[...]` m; None: unchanged."""
    if z is None:
        return primitive
    up = torch.stack([torch.zeros_like(z), torch.zeros_like(z), z], -1)[..., None, :]
    return replace(primitive, origin=primitive.origin + up)
