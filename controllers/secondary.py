"""Secondary rays (T 7.5.1): what else is known of the point that a ray hits, from its sight of observers, lamps and street lamps.

All functions take points as the world has them, `[..., 3, N]` in m, and are pure: `controllers.rthc.trace` has the points.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

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


def shares(lights: Sequence[Light], points: Tensor, occluded: Caster | None = None) -> Tensor:
    """Which share of a setpoint each light takes, `[L, ..., N]`: in proportion to what it can give there (T 7.5.1).

    They add up to one where any light gets to, so light is not doubled; a light that something blocks takes none, and the others
    compensate. Two cars that draw one symbol together are lights of one list.
    """
    possible = torch.stack([light.possible(points) for light in lights])
    if occluded is not None:
        for light, at_points in zip(lights, possible, strict=True):
            at_points *= ~_cast(occluded, points, light.T_world_headlight[:3, 3])
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


def seen_symbol(points: Tensor, eye: Tensor, origin: Tensor, d1: Tensor, d2: Tensor, image: Tensor) -> Tensor:
    """Value `[..., N]` of the flying symbol where the rays from points to the eye `[..., 3]` meet it (T 7.2.2, fig. 7.9); else zero.

    origin, d1, d2: `[..., 3]` m, the symbol's rectangle; image: `[h, w]` in 0..1, bilinear, texel centres at (k + 1/2) / n.
    """
    ray = eye[..., None] - points
    n = torch.linalg.cross(d1, d2)
    along = (ray * n[..., None]).sum(-2)
    q = points - origin[..., None]
    reach = -(q * n[..., None]).sum(-2) / torch.where(along == 0, 1.0, along)
    hit = q + reach[..., None, :] * ray
    n2 = (n * n).sum(-1)[..., None]
    u = (hit * torch.linalg.cross(d2, n)[..., None]).sum(-2) / n2
    v = (hit * torch.linalg.cross(n, d1)[..., None]).sum(-2) / n2
    inside = (along != 0) & (reach > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    rows, cols = image.shape
    grid = TexelGrid(rows=rows, cols=cols, left=1.0, right=0.0, bottom=0.0, top=1.0)
    texel, weight = bilinear(grid, v * rows, u * cols)
    return torch.where(inside, (image.to(points).flatten()[texel] * weight).sum(0), 0.0)


def drawing_rectangle(origin: Tensor, d1: Tensor, d2: Tensor, eye: Tensor, at: Tensor, normal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The smallest rectangle on a plane that holds all that an observer sees through the flying symbol: origin, d1, d2 `[..., 3]` m.

    origin, d1, d2, eye: `[..., 3]` m, the symbol and the observer (T fig. 7.9). at, normal: `[..., 3]`, a point of the plane and its unit
    normal. Everything of the symbol must lie below the observer's horizon: above it, the corners' images are not numbers.
    A smallest rectangle around four points has a side along one of their connections.
    """
    corners = torch.stack([origin, origin + d1, origin + d1 + d2, origin + d2], -2)
    ray = corners - eye[..., None, :]
    down = (ray * normal[..., None, :]).sum(-1)
    depth = ((at - eye) * normal).sum(-1)[..., None] / down
    seen = eye[..., None, :] + torch.where(depth > 0, depth, torch.nan)[..., None] * ray
    first, second = torch.triu_indices(4, 4, 1, device=seen.device)
    along = torch.nn.functional.normalize(seen[..., second, :] - seen[..., first, :], dim=-1)
    across = torch.linalg.cross(normal[..., None, :].expand_as(along), along)
    a = (seen[..., None, :, :] * along[..., :, None, :]).sum(-1)
    b = (seen[..., None, :, :] * across[..., :, None, :]).sum(-1)
    low_a, low_b = a.amin(-1), b.amin(-1)
    size_a, size_b = a.amax(-1) - low_a, b.amax(-1) - low_b
    best = (size_a * size_b).argmin(-1, keepdim=True)

    def chosen(per_side: Tensor) -> Tensor:
        return per_side.gather(-1, best)

    along, across = (v.gather(-2, best[..., None].expand(*best.shape, 3))[..., 0, :] for v in (along, across))
    height = (at * normal).sum(-1, keepdim=True)
    corner = chosen(low_a) * along + chosen(low_b) * across + height * normal
    return corner, chosen(size_a) * along, chosen(size_b) * across


def _cast(occluded: Caster, points: Tensor, target: Tensor) -> Tensor:
    """A caster's answer for points with batch dimensions."""
    flat = points.movedim(-2, 0).flatten(1)
    return occluded(flat, target).reshape(points.shape[:-2] + points.shape[-1:])
