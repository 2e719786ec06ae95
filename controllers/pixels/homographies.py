"""Homographies from a headlight's rays to primitives, 3 x 3 each (T 7.3.3, eq. 7.3.2 and 7.3.3).

All rays of a module share their origin: with q from the lamp to the primitive's centre, n = d1 x d2 and the unnormalised ray
d = [1, y, z], u = d.(d2 x q) / d.n, v = d.(q x d1) / d.n, x = q.n / d.n. Counted from the centre, u and v run from -1/2 to 1/2; twice that,
from -1 to 1, is what image sampling takes. Turned so that q.n > 0, a ray hits where |u d.n| <= d.n and |v d.n| <= d.n. Each term is affine
in the texel's row and column, so no rays are stored.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.windows import NEAREST_M
from luxloop.world.texels import TexelGrid


def drawing_rectangle(origin: Tensor, d1: Tensor, d2: Tensor, eye: Tensor, at: Tensor, normal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The smallest rectangle on a plane that contains the flying symbol's image from the eye: origin, d1, d2 `[..., 3]` m.

    origin, d1, d2, eye: `[..., 3]` m, the symbol and the observer (T fig. 7.9). at, normal: `[..., 3]`, a point of the plane and its unit
    normal. All corners of the symbol must lie below the observer's horizon, else their images are NaN. The smallest rectangle around four
    points has a side along one of their connections.
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


def sight(eye: Tensor, origin: Tensor, d1: Tensor, d2: Tensor, n: Tensor, qn: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The homography from a lamp's rays, by their hits on the road, to the flying symbol (T 7.2.2, fig. 7.9).

    All `[..., 3]` in the lamp's frame: eye and flying symbol, and the road primitive's n = d1 x d2 and qn `[...]` = q.n, turned so that
    qn > 0. Returns n', u' and v' `[..., 3]`: a ray d that hits the primitive shows the symbol at u'.d / n'.d and v'.d / n'.d, which run
    from -1 to 1 from border to border, provided n'.d > 0. With the hit point p = qn d / n.d, the eye's line of sight p - e is parallel to
    qn d - (n.d) e, which is linear in d.
    """
    q = origin + (d1 + d2) / 2 - eye
    across = torch.linalg.cross(d1, d2)
    turn = torch.where((q * across).sum(-1, keepdim=True) < 0, -1.0, 1.0).to(q)

    def along_rays(a: Tensor) -> Tensor:
        return turn * (qn[..., None] * a - n * (eye * a).sum(-1, keepdim=True))

    return along_rays(across), along_rays(2 * torch.linalg.cross(d2, q)), along_rays(2 * torch.linalg.cross(q, d1))


ROUNDINGS = 4  # error bound of a plane; below 1 in thousands of random scenes


@dataclass(frozen=True)
class Homographies:
    """The homographies of P primitives, as vectors `[..., P, 3]` to multiply with rays [1, y, z], and `[..., P]`.

    n, uv `[..., P, 2, 3]`: d.n, and twice u d.n and v d.n, with signs such that `qn` = q.n is positive; where it is zero, no ray hits.
    position: `[3]` m, of the headlight in the world. middle: q. normal: as given. mask: whether the primitive is one (zero setpoint of
    infinite weight). d1, d2: edges `[..., P, 3]` m. sight: as n and uv, from a ray to the point of the flying symbol in which the observer
    sees its hit; None without observers. Properties that only masks and overlapping primitives need are computed on first use.
    """

    grid: TexelGrid
    position: Tensor
    n: Tensor
    uv: Tensor
    qn: Tensor
    middle: Tensor
    normal: Tensor
    mask: Tensor
    d1: Tensor
    d2: Tensor
    sight: tuple[Tensor, Tensor] | None

    @cached_property
    def corners(self) -> Tensor:
        """`[..., P, 4, 3]` m."""
        origin = self.middle - (self.d1 + self.d2) / 2
        return torch.stack([origin, origin + self.d1, origin + self.d2, origin + self.d1 + self.d2], -2).detach()

    @cached_property
    def toward(self) -> Tensor:
        """q.normal with its sign reversed: positive where the lamp sees the front of a primitive's centre, `[..., P]` m."""
        return -(self.normal * self.middle).sum(-1).detach()

    @cached_property
    def margin(self) -> tuple[Tensor, Tensor]:
        """aside and wider `[..., P, 2]`, which extend a mask by one texel: |uv - aside| <= n + wider."""
        n, mask = self.n[..., None, :], self.mask[..., None]
        less, more = self._change(n - self.uv), self._change(n + self.uv)
        return mask * (less - more) / 2, mask * (less + more) / 2

    def _change(self, a: Tensor) -> Tensor:
        """Change of a product with a ray over one texel."""
        grid, a = self.grid, a.detach()
        return a[..., 1].abs() * ((grid.left - grid.right) / grid.cols) + a[..., 2].abs() * ((grid.top - grid.bottom) / grid.rows)

    @cached_property
    def range(self) -> tuple[Tensor, Tensor]:
        """1/x of the farthest and of the nearest corner, `[..., P]` 1/m each."""
        x = self.corners[..., 0].clamp(min=NEAREST_M)
        return 1 / x.amax(-1), 1 / x.amin(-1)

    @cached_property
    def rounding(self) -> Tensor:
        """Bound of the relative error of a hit's distance: rounding of the largest coordinate over the lamp's distance from the plane.

        For nearly parallel edges that distance is multiplied by the sine of their angle, since the cross product loses as much precision.
        """
        farthest = self.corners.norm(dim=-1).amax(-1) + self.position.norm()
        sides = (self.corners[..., 1:3, :] - self.corners[..., :1, :]).norm(dim=-1).prod(-1)
        return (ROUNDINGS * torch.finfo(self.qn.dtype).eps * farthest * sides / self.qn).detach()

    @cached_property
    def outline(self) -> tuple[Tensor, Tensor]:
        """Least and greatest (row, column) of the projected corners, `[..., P, 2]` each; infinite where a corner lies behind the lamp."""
        x, y, z = self.corners.unbind(-1)
        behind = (x < NEAREST_M).any(-1)[..., None]
        x = x.clamp(min=NEAREST_M)
        at = torch.stack(self.grid.texel_of(y / x, z / x), -1)
        return at.amin(-2).masked_fill(behind, -torch.inf), at.amax(-2).masked_fill(behind, torch.inf)


def homographies(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor) -> Homographies:
    """The homographies of all primitives for a headlight at `[4, 4]` in the world: T eq. 7.3.3 solved by Cramer's rule."""
    R, position = T_world_headlight[:3, :3].to(primitives.origin), T_world_headlight[:3, 3].to(primitives.origin)
    origin, d1, d2, normal = (v @ R for v in (primitives.origin - position, primitives.d1, primitives.d2, primitives.normal))
    q = origin + (d1 + d2) / 2
    n = torch.linalg.cross(d1, d2)
    qn = (q * n).sum(-1)
    sign = torch.ones_like(qn).copysign(qn.detach())[..., None]
    n, uv = n * sign, torch.stack([torch.linalg.cross(d2, q), torch.linalg.cross(q, d1)], -2) * (2 * sign[..., None])
    edge_on = (qn == 0)[..., None]  # or without area: no ray hits it
    n, uv = torch.where(edge_on, n.new_tensor([-1.0, 0.0, 0.0]), n), uv.masked_fill(edge_on[..., None], 0.0)
    qn = torch.where(edge_on[..., 0], 1.0, qn.abs())
    eyes = None
    if (who := primitives.observer) is not None:
        across, *edges = sight((who.eye - position) @ R, (who.origin - position) @ R, who.d1 @ R, who.d2 @ R, n, qn)
        eyes = (across, torch.stack(edges, -2))
    mask = (primitives.value == 0) & primitives.weight.isinf()
    return Homographies(grid, position, n, uv, qn, q, normal, mask, d1, d2, eyes)
