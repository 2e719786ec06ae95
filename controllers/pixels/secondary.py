"""Secondary rays (T 7.5.1), from the hit point of a ray to observers, lamps and street lamps.

All functions are pure and take points `[..., 3, N]` in m in the world frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.controllers.pixels.primitives import U_ABS, Primitives, names_module
from luxloop.world.frames import inverse, transform
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import ModuleCommand
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.rendering.raycast import sees
from luxloop.world.scene.scene import StreetLamp
from luxloop.world.scene.triangles import Triangles
from luxloop.world.texels import TexelGrid

Caster = Callable[[Tensor, Tensor], Tensor]  # (points [3, N], target [3]) -> [N] bool: whether the target is occluded

DARKEST = 1e-3  # least dimming share that is compensated: setpoints rise at most 1000-fold
BIAS_M = 0.02  # distance within which a surface does not occlude a point


def scene_caster(triangles: Triangles, T_world_points: Tensor | None = None) -> Caster:
    """A caster of shadow rays through a scene's triangles. T_world_points: `[4, 4]`, pose of the frame of the points, by default the world.

    The road casts no shadow, since a primitive 1 cm below the road would be occluded everywhere.
    """

    def occluded(points: Tensor, target: Tensor) -> Tensor:
        if T_world_points is not None:
            T = T_world_points.to(points)
            points, target = transform(T, points), transform(T, target[:, None].to(points))[:, 0]
        return ~sees(triangles.off_road, target, points, BIAS_M)

    return occluded


@dataclass(frozen=True, eq=False)
class PotentialLight:
    """The potential light of a module, of this or another car.

    full: `[rows, cols]` cd, all pixels on, undimmed. T_world_headlight: `[4, 4]`. intensity: dimming share 0..1.
    """

    grid: TexelGrid
    full: Tensor
    T_world_headlight: Tensor
    intensity: float = 1.0

    def under(self, command: ModuleCommand) -> "PotentialLight":
        """The light of the module turned and dimmed as commanded."""
        return replace(self, T_world_headlight=command.turn(self.T_world_headlight), intensity=command.intensity)

    @classmethod
    def of(cls, headlight: Headlight, T_world_headlight: Tensor) -> "PotentialLight":
        values = headlight.matrix.values
        return cls(headlight, headlight.light_texture(torch.ones(headlight.n_pixels).to(values)), T_world_headlight)

    def possible(self, points: Tensor) -> Tensor:
        """`I_sum / d^2`, `[..., N]` in lx (T eq. 2.1.4): largest illuminance of a surface facing the lamp; zero outside its light
        texture.
        """
        projection, full = self._projection.to(points), self.full.to(points)
        x, *_ = seen = (projection[:, :3] @ points + projection[:, 3:]).movedim(-2, 0)
        at = (seen[1:] / torch.where(x > 0, x, 1.0)).movedim(0, -1)
        inside = (at.abs().amax(-1) <= 1) & (x > 0)
        intensity = grid_sample(full[None, None], at.reshape(1, 1, -1, 2), padding_mode="border", align_corners=False).view_as(x)
        return self.intensity * intensity * inside * lux_per_cd(self.T_world_headlight[:3, 3:].to(points) - points)

    @cached_property
    def _projection(self) -> Tensor:
        """Projection `[3, 4]` of world points to (x, x column, x row); x is the distance ahead, column and row run over -1..1."""
        wide, high = self.grid.left - self.grid.right, self.grid.top - self.grid.bottom
        column = [(self.grid.left + self.grid.right) / wide, -2 / wide, 0.0]
        row = [(self.grid.top + self.grid.bottom) / high, 0.0, -2 / high]
        return self.T_world_headlight.new_tensor([[1.0, 0.0, 0.0], column, row]) @ inverse(self.T_world_headlight)[:3]


def shares(lights: Sequence[PotentialLight], points: Tensor, occluded: Caster | None = None, asked: Tensor | None = None) -> Tensor:
    """Share of a setpoint for each light, `[L, ..., N]`, in proportion to its potential illuminance there (T 7.5.1).

    The shares add up to 1 wherever any light reaches, so light is not doubled; an occluded light has the share 0. Lights of two cars that
    draw one symbol go into one list. asked: `[..., N]` bool, points for which shadow rays are cast, by default all.
    """
    possible = torch.stack([light.possible(points) for light in lights])
    if occluded is not None:
        possible = possible * torch.stack([visible_from(points, light.T_world_headlight[:3, 3], occluded, asked) for light in lights])
    total = possible.sum(0)
    return torch.where(total > 0, possible / torch.where(total > 0, total, 1.0), 0.0)


def visible_from(points: Tensor, eye: Tensor, occluded: Caster, asked: Tensor | None = None) -> Tensor:
    """Whether an observer at `[..., 3]` m sees points, `[..., N]` bool (T 7.5.1).

    asked: `[..., N]` bool, points for which rays are cast, by default all; the others count as seen.
    """
    asked = torch.ones_like(points[..., 0, :], dtype=torch.bool) if asked is None else asked
    seen = torch.ones_like(asked)
    scenes = (points.reshape(-1, *points.shape[-2:]), eye.expand(*points.shape[:-2], 3).reshape(-1, 3), asked.reshape(-1, asked.shape[-1]))
    for at, target, of_scene, answer in zip(*scenes, seen.view(-1, seen.shape[-1]), strict=True):
        answer[of_scene] = ~occluded(at[:, of_scene], target)
    return seen


def street_light(
    points: Tensor, normals: Tensor, lamps: Sequence[StreetLamp], occluded: Caster | None = None, asked: Tensor | None = None
) -> Tensor:
    """Illuminance `[..., N]` in lx by street lamps (T 7.5.1, eq. 2.1.5).

    normals: unit, broadcastable to `[..., 3, N]`. asked: as for `visible_from`.
    """
    total = torch.zeros_like(points[..., 0, :])
    for lamp in lamps:
        position = points.new_tensor(lamp.position_m)
        light = lamp.intensity_cd * lux_per_cd(position[:, None] - points, normals)
        total = total + (light if occluded is None else light * visible_from(points, position, occluded, asked))
    return total


def subtract_street_light(setpoint_cd: Tensor, street_lx: Tensor, points: Tensor, normals: Tensor, position: Tensor) -> Tensor:
    """Setpoints `[..., N]` in cd minus the light of street lamps (T 7.5.1), at least zero.

    position: `[3]` m, of the lamp that gets the setpoints; normals: unit, broadcastable to `[..., 3, N]`.
    """
    per_cd = lux_per_cd(position.to(points)[:, None] - points, normals)
    return torch.where(per_cd > 0, (setpoint_cd - street_lx / torch.where(per_cd > 0, per_cd, 1.0)).clamp(min=0), setpoint_cd)


@dataclass(frozen=True, eq=False)
class SecondaryRays:
    """Secondary rays of one module from the hits on primitives.

    lights: names and lights of all modules of all lamps and cars that draw together. own: index of the module that casts the rays.
    street_lamps: lamps whose light is subtracted. occluded: caster of secondary rays; None: no occlusion.
    """

    lights: tuple[tuple[str, PotentialLight], ...]
    own: int
    street_lamps: tuple[StreetLamp, ...] = ()
    occluded: Caster | None = None

    def ask(self, primitives: Primitives, p: int) -> bool:
        """Whether secondary rays may change the setpoint of the p-th primitive."""
        in_light = int(primitives.quantity[p]) < U_ABS
        shared = bool(primitives.shared[p]) and len(self.lights) > 1
        dimmed = self.lights[self.own][1].intensity < 1
        hidden = self.occluded is not None and primitives.has_observer(p)
        return hidden or (in_light and (shared or dimmed or bool(self.street_lamps) or self.occluded is not None))

    def adjust(self, value: Tensor, points: Tensor, hit: Tensor, primitives: Primitives, p: int) -> Tensor:
        """Adjusted setpoints `[..., rows, cols]` of the p-th primitive at hit points `[..., 3, rows, cols]` m, valid where hit.

        Setpoints in cd and lx lose the light of street lamps, are shared among the lights that may draw, and are raised for a dimmed
        module. Points that the primitive's observer cannot see are off.
        """
        size, value, points, hit = value.shape[-2:], value.flatten(-2), points.flatten(-2), hit.flatten(-2)
        if int(primitives.quantity[p]) < U_ABS:
            names, normals = primitives.modules[p], primitives.normal[..., p, :, None]
            if self.street_lamps:
                street = street_light(points, normals, self.street_lamps, self.occluded, hit)
                value = subtract_street_light(value, street, points, normals, self.lights[self.own][1].T_world_headlight[:3, 3])
            others = bool(primitives.shared[p])
            drawing = [k for k, (name, _) in enumerate(self.lights) if k == self.own or (others and names_module(names, name))]
            value = value * shares([self.lights[k][1] for k in drawing], points, self.occluded, hit)[drawing.index(self.own)]
            value = value / max(self.lights[self.own][1].intensity, DARKEST)
        if self.occluded is not None and primitives.observer is not None and primitives.has_observer(p):
            value = value * visible_from(points, primitives.observer.eye[..., p, :], self.occluded, hit)
        return value.unflatten(-1, size)
