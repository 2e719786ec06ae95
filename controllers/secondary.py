"""Secondary rays (T 7.5.1): what else is known of the point that a ray hits, from its sight of observers, lamps and street lamps.

All functions take points as the world has them, `[..., 3, N]` in m, and are pure: `controllers.rthc.trace` has the points.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from controllers.primitives import U_ABS, Primitives
from controllers.rthc import Setpoints
from world.frames import inverse, transform
from world.headlight import Headlight
from world.raycast import first_hits
from world.scene import StreetLamp
from world.texels import TexelGrid, bilinear
from world.triangles import Triangles, depths

Caster = Callable[[Tensor, Tensor], Tensor]  # (points [3, N], target [3]) -> [N] bool: something lies between them

BIAS_M = 0.02  # what stands closer to the point belongs to the surface that the point lies on


def scene_caster(triangles: Triangles, skip: Collection[int] = (0,)) -> Caster:
    """A caster of shadow rays through a scene's triangles. skip: ids of the objects that hide nothing, by default the road.

    The road is skipped since primitives lie near it, not on it: a primitive 1 cm below the road would be hidden everywhere.
    """
    casting = Triangles(tuple(placed for placed in triangles.placed if placed.object_id not in skip))

    def occluded(points: Tensor, target: Tensor) -> Tensor:
        origin, directions = target.double().cpu(), points.double().cpu() - target.double().cpu()[:, None]
        face = first_hits(casting, origin, directions)
        length = directions.norm(dim=0)
        return (depths(casting, face, origin, directions) * length < length - BIAS_M).to(points.device)

    return occluded


@dataclass(frozen=True, eq=False)
class Light:
    """What a module can give. full: `[rows, cols]` cd, all pixels on. T_world_headlight: `[4, 4]`. Another car's module is one as well."""

    grid: TexelGrid
    full: Tensor
    T_world_headlight: Tensor

    @classmethod
    def of(cls, headlight: Headlight, T_world_headlight: Tensor) -> "Light":
        values = headlight.matrix.values
        return cls(headlight, headlight.light_texture(torch.ones(headlight.n_pixels).to(values)), T_world_headlight)

    def possible(self, points: Tensor) -> Tensor:
        """`I_sum / d^2` `[..., N]` in lx, on a surface that faces the lamp; zero outside of its light texture."""
        x, y, z = transform(inverse(self.T_world_headlight).to(points), points).unbind(-2)
        row, col = self.grid.texel_of(y / x, z / x)
        texel, weight = bilinear(self.grid, row, col)
        intensity = (self.full.to(points).flatten()[texel] * (weight * (x > 0)).to(points)).sum(0)
        return intensity / (x * x + y * y + z * z)


def shares(lights: Sequence[Light], points: Tensor, occluded: Caster | None = None, may: Tensor | None = None) -> Tensor:
    """Which share of a setpoint each light takes, `[L, ..., N]`: in proportion to what it can give there (T 7.5.1).

    may: `[L, ..., N]` bool, which lights are meant at all, by default all of them.

    They add up to one where any light gets to, so light is not doubled; a light that something blocks takes none, and the others
    compensate. Two cars that draw one symbol together are lights of one list.
    """
    possible = torch.stack([light.possible(points) for light in lights])
    if occluded is not None:
        for light, at_points in zip(lights, possible, strict=True):
            at_points *= ~_cast(occluded, points, light.T_world_headlight[:3, 3])
    if may is not None:
        possible = possible * may
    total = possible.sum(0)
    return torch.where(total > 0, possible / torch.where(total > 0, total, 1.0), 0.0)


def seen_by(points: Tensor, eye: Tensor, occluded: Caster) -> Tensor:
    """Which points an observer at `[3]` m sees, `[..., N]` bool: where nobody looks, a symbol need not be drawn."""
    return ~_cast(occluded, points, eye)


def street_light(points: Tensor, normals: Tensor, lamps: Sequence[StreetLamp], occluded: Caster | None = None) -> Tensor:
    """Illuminance `[..., N]` in lx by street lamps on surfaces with unit normals broadcastable to `[..., 3, N]`."""
    total = torch.zeros_like(points[..., 0, :])
    for lamp in lamps:
        position = torch.tensor(lamp.position_m).to(points)
        away = position[:, None] - points
        d2 = away.square().sum(-2)
        light = lamp.intensity_cd * (normals * away).sum(-2).clamp(min=0) / d2**1.5
        total = total + (light if occluded is None else light * ~_cast(occluded, points, position))
    return total


def less_street_light(setpoint_cd: Tensor, street_lx: Tensor, points: Tensor, normals: Tensor, position: Tensor) -> Tensor:
    """Luminous intensities `[..., N]` that add to street lamps what is missing: a negative offset (T 7.5.1), never below zero.

    position: `[3]` m, the lamp whose intensities they are; normals: unit, broadcastable to `[..., 3, N]`.
    """
    away = position.to(points)[:, None] - points
    d2 = away.square().sum(-2)
    cos = (normals * away).sum(-2) / d2.sqrt()
    offset = street_lx * d2 / torch.where(cos > 0, cos, 1.0)
    return torch.where(cos > 0, (setpoint_cd - offset).clamp(min=0), setpoint_cd)


def _cast(occluded: Caster, points: Tensor, target: Tensor) -> Tensor:
    """A caster's answer for points with batch dimensions."""
    flat = points.movedim(-2, 0).flatten(1)
    return occluded(flat, target).reshape(points.shape[:-2] + points.shape[-1:])


@dataclass(frozen=True, eq=False)
class SecondaryRays:
    """What a module's rays ask where they hit, after the primary rays.

    lights: all modules that may draw, of all lamps and cars that draw together, by name. own: which of them the setpoints are for.
    street_lamps: whose light is taken off. occluded: what blocks secondary rays, nothing where it is None.
    """

    lights: tuple[tuple[str, Light], ...]
    own: int
    street_lamps: tuple[StreetLamp, ...] = ()
    occluded: Caster | None = None

    def adjusted(self, setpoints: Setpoints, primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor) -> Setpoints:
        """Setpoints less the street lamps' light, shared among the lights that may draw, and off where their observer cannot see them.

        Only setpoints in cd and lx are shared and lessened: a utilisation says itself what each module does.
        """
        if not len(primitives) or not setpoints.value.numel():
            return setpoints
        w = setpoints.window
        points, normals = hit_points(setpoints, primitives, grid, T_world_headlight)
        winner = setpoints.winner.long().flatten(-2) if setpoints.winner is not None else torch.zeros_like(points[..., 0, :]).long()
        value, hit = setpoints.value.flatten(-2), setpoints.hit.flatten(-2)
        physical = (primitives.quantity < U_ABS).to(value.device)[winner] & hit
        wanted = value
        if self.street_lamps:
            street = street_light(points, normals, self.street_lamps, self.occluded)
            wanted = less_street_light(wanted, street, points, normals, T_world_headlight[:3, 3])
        may = torch.tensor([[may_draw(names, name) for names in primitives.modules] for name, _ in self.lights])
        taken = shares([light for _, light in self.lights], points, self.occluded, may.to(value.device)[:, winner])[self.own]
        value = torch.where(physical, wanted * taken, value)
        if self.occluded is not None and primitives.observer is not None:
            for p in primitives.observer.active.nonzero()[:, 0].tolist():
                unseen = _cast(self.occluded, points, primitives.observer.eye[..., p, :])
                value = torch.where(hit & (winner == p) & unseen, 0.0, value)
        size = (w.row_stop - w.row_start, w.col_stop - w.col_start)
        return replace(setpoints, value=value.unflatten(-1, size))


def hit_points(setpoints: Setpoints, primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor) -> tuple[Tensor, Tensor]:
    """Where the rays of a window hit their primitives, and the primitives' normals there, both `[..., 3, rows * cols]`.

    Where nothing is hit, the point lies a metre before the lamp.
    """
    rows, cols = setpoints.window.slices
    y, z = grid.tangents(primitives.origin.dtype, primitives.origin.device)
    y, z = torch.broadcast_tensors(y[cols], z[rows, None])
    T = T_world_headlight.to(y)
    ray = T[:3, :3] @ torch.stack([torch.ones_like(y), y, z]).flatten(1)
    winner = setpoints.winner.long().flatten(-2) if setpoints.winner is not None else torch.zeros_like(setpoints.hit).long().flatten(-2)

    def won(vectors: Tensor) -> Tensor:
        vectors = vectors.expand(*winner.shape[:-1], *vectors.shape[-2:])
        return vectors.gather(-2, winner[..., None].expand(*winner.shape, 3)).transpose(-1, -2)

    n = won(torch.linalg.cross(primitives.d1, primitives.d2))
    along = (n * ray).sum(-2)
    hit = setpoints.hit.flatten(-2) & (along != 0)
    x = ((won(primitives.origin) - T[:3, 3:]) * n).sum(-2) / torch.where(hit, along, 1.0)
    return T[:3, 3:] + torch.where(hit, x, 1.0)[..., None, :] * ray, won(primitives.normal)


def may_draw(names: Sequence[str], module: str) -> bool:
    """Whether a primitive for these modules, or for all where there are none, is meant for "left hires", say."""
    return not names or any(f" {name} " in f" {module} " for name in names)
