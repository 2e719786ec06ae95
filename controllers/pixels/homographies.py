"""Primitives as a headlight's rays see them: one 3 x 3 homography each (T 7.3.3, eq. 7.3.2 and 7.3.3).

All rays of a module share their origin: with q from the lamp to the primitive's centre, n = d1 x d2 and the unnormalised ray
d = [1, y, z], u = d.(d2 x q) / d.n, v = d.(q x d1) / d.n, x = q.n / d.n. Counted from the centre, u and v run from -1/2 to 1/2; twice that,
from -1 to 1, is what image sampling takes. Turned so that q.n > 0, a ray hits where |u d.n| <= d.n and |v d.n| <= d.n. Each term is affine
in the texel's row and column, so no rays are stored.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from controllers.pixels.anamorphic import sight
from controllers.pixels.primitives import Primitives
from controllers.pixels.windows import NEAREST_M
from world.texels import TexelGrid

ROUNDINGS = 4  # error bound of a plane; below 1 in thousands of random scenes


@dataclass(frozen=True)
class Homographies:
    """Primitives as a headlight sees them: `[..., P, 3]`, to be multiplied with rays [1, y, z], and `[..., P]`.

    n, uv `[..., P, 2, 3]`: d.n and twice u d.n and v d.n, turned so that `qn`, q.n, is positive; where that is
    zero they are such that nothing hits. position: `[3]` m, of the headlight in the world. middle: q; normal: as given. mask: a zero
    setpoint of infinite weight. corners: `[..., P, 4, 3]` m. sight: as n and uv, for where a primitive's observer sees a hit in the
    flying symbol; None where there are no observers. What only masks and rivals need is made when it is asked for.
    """

    grid: TexelGrid
    position: Tensor
    n: Tensor
    uv: Tensor
    qn: Tensor
    middle: Tensor
    normal: Tensor
    mask: Tensor
    corners: Tensor
    sight: tuple[Tensor, Tensor] | None

    @cached_property
    def toward(self) -> Tensor:
        """Cosine, times a length, at which the lamp sees the primitives' middles."""
        return -(self.normal * self.middle).sum(-1).detach()

    @cached_property
    def margin(self) -> tuple[Tensor, Tensor]:
        """aside, wider `[..., P, 2]`: how far a mask's edges move for it to reach one texel further: |uv - aside| <= n + wider."""
        n, mask = self.n[..., None, :], self.mask[..., None]
        less, more = self._change(n - self.uv), self._change(n + self.uv)
        return mask * (less - more) / 2, mask * (less + more) / 2

    def _change(self, a: Tensor) -> Tensor:
        """By how much a product with a ray changes over one texel."""
        grid, a = self.grid, a.detach()
        return a[..., 1].abs() * ((grid.left - grid.right) / grid.cols) + a[..., 2].abs() * ((grid.top - grid.bottom) / grid.rows)

    @cached_property
    def range(self) -> tuple[Tensor, Tensor]:
        """1/x of the farthest and of the nearest corner."""
        x = self.corners[..., 0].clamp(min=NEAREST_M)
        return 1 / x.amax(-1), 1 / x.amin(-1)

    @cached_property
    def rounding(self) -> Tensor:
        """Relative error of a hit's distance: the rounding of the farthest coordinate, over the lamp's distance from the plane.

        Nearly parallel edges count as a plane that is nearer by the sine of their angle, since the cross product loses as much precision.
        """
        farthest = self.corners.norm(dim=-1).amax(-1) + self.position.norm()
        sides = (self.corners[..., 1:3, :] - self.corners[..., :1, :]).norm(dim=-1).prod(-1)
        return (ROUNDINGS * torch.finfo(self.qn.dtype).eps * farthest * sides / self.qn).detach()

    @cached_property
    def outline(self) -> tuple[Tensor, Tensor]:
        """Least and greatest row and column of the projected corners, `[..., P, 2]`, infinite where one lies behind the lamp."""
        x, y, z = self.corners.unbind(-1)
        behind = (x < NEAREST_M).any(-1)[..., None]
        x = x.clamp(min=NEAREST_M)
        at = torch.stack(self.grid.texel_of(y / x, z / x), -1)
        return at.amin(-2).masked_fill(behind, -torch.inf), at.amax(-2).masked_fill(behind, torch.inf)


def homographies(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor) -> Homographies:
    """Every primitive in the coordinates of a headlight's rays: the solution of T eq. 7.3.3 by Cramer's rule."""
    R, position = T_world_headlight[:3, :3].to(primitives.origin), T_world_headlight[:3, 3].to(primitives.origin)
    origin, d1, d2, normal = (v @ R for v in (primitives.origin - position, primitives.d1, primitives.d2, primitives.normal))
    q = origin + (d1 + d2) / 2
    n = torch.linalg.cross(d1, d2)
    qn = (q * n).sum(-1)
    sign = torch.where(qn < 0, -1.0, 1.0).to(qn)[..., None]
    n, uv = n * sign, torch.stack([2 * torch.linalg.cross(d2, q) * sign, 2 * torch.linalg.cross(q, d1) * sign], -2)
    edge_on = (qn == 0)[..., None]  # or without an area: what no ray hits
    n, uv = torch.where(edge_on, n.new_tensor([-1.0, 0.0, 0.0]), n), uv.masked_fill(edge_on[..., None], 0.0)
    qn = torch.where(edge_on[..., 0], 1.0, qn.abs())
    eyes = None
    if (who := primitives.observer) is not None:
        across, *edges = sight((who.eye - position) @ R, (who.origin - position) @ R, who.d1 @ R, who.d2 @ R, n, qn)
        eyes = (across, torch.stack(edges, -2))
    mask = (primitives.value == 0) & primitives.weight.isinf()
    corners = torch.stack([origin, origin + d1, origin + d2, origin + d1 + d2], -2).detach()
    return Homographies(grid, position, n, uv, qn, q, normal, mask, corners, eyes)
