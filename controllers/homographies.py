"""Primitives as a headlight's rays see them: one 3 x 3 homography each (T 7.3.3).

All rays of a module share their origin: with q from the lamp to the primitive's centre, n = d1 x d2 and the unnormalised ray
d = [1, y, z], u = d.(d2 x q) / d.n, v = d.(q x d1) / d.n, x = q.n / d.n. Counted from the centre, u and v run from -1/2 to 1/2; twice that,
from -1 to 1, is what image sampling takes. Turned so that q.n > 0, a ray hits where |u d.n| <= d.n and |v d.n| <= d.n. Each term is affine
in the texel's row and column, so no rays are stored.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from controllers.observer import sight
from controllers.primitives import Primitives
from controllers.windows import NEAREST_M
from world.texels import TexelGrid


@dataclass(frozen=True)
class Homographies:
    """Primitives as a headlight sees them: `[..., P, 3]`, to be multiplied with rays [1, y, z], and `[..., P]`.

    n, u, v: d.n and twice u d.n and v d.n, turned so that `qn`, q.n, is positive. normal: as given. mask: a zero setpoint of infinite
    weight. aside_u, wider_u, aside_v, wider_v: how far a mask's edges move for it to reach one texel further: |u - aside| <= n + wider.
    toward: cosine, times a length, at which the lamp sees the primitive's middle. near, far: 1/x of the nearest and the
    farthest corner. low, high: `[..., P, 2]`, projected outline in rows and columns, infinite where it reaches behind the lamp.
    sight: as n, u and v, for where a primitive's observer sees a hit in the flying symbol; None where there are no observers.
    """

    n: Tensor
    u: Tensor
    v: Tensor
    normal: Tensor
    qn: Tensor
    mask: Tensor
    aside_u: Tensor
    wider_u: Tensor
    aside_v: Tensor
    wider_v: Tensor
    toward: Tensor
    near: Tensor
    far: Tensor
    low: Tensor
    high: Tensor
    sight: tuple[Tensor, Tensor, Tensor] | None


def homographies(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor) -> Homographies:
    """Every primitive in the coordinates of a headlight's rays."""
    R, position = T_world_headlight[:3, :3].to(primitives.origin), T_world_headlight[:3, 3].to(primitives.origin)
    origin, d1, d2, normal = (v @ R for v in (primitives.origin - position, primitives.d1, primitives.d2, primitives.normal))
    q = origin + (d1 + d2) / 2
    n = torch.linalg.cross(d1, d2)
    qn = (q * n).sum(-1)
    sign = torch.where(qn < 0, -1.0, 1.0).to(qn)[..., None]
    n, u, v = n * sign, 2 * torch.linalg.cross(d2, q) * sign, 2 * torch.linalg.cross(q, d1) * sign

    eyes = None
    if (who := primitives.observer) is not None:
        eyes = sight((who.eye - position) @ R, (who.origin - position) @ R, who.d1 @ R, who.d2 @ R, n, qn.abs())
    mask = (primitives.value == 0) & primitives.weight.isinf()

    def change(a: Tensor) -> Tensor:
        """By how much a product with a ray changes over one texel."""
        a = a.detach()
        return a[..., 1].abs() * ((grid.left - grid.right) / grid.cols) + a[..., 2].abs() * ((grid.top - grid.bottom) / grid.rows)

    x, y, z = torch.stack([origin, origin + d1, origin + d2, origin + d1 + d2], -2).detach().unbind(-1)
    behind = (x < NEAREST_M).any(-1)[..., None]
    x = x.clamp(min=NEAREST_M)
    at = torch.stack(grid.texel_of(y / x, z / x), -1)
    return Homographies(
        n,
        u,
        v,
        normal,
        qn.abs(),
        mask,
        mask * (change(n - u) - change(n + u)) / 2,
        mask * (change(n - u) + change(n + u)) / 2,
        mask * (change(n - v) - change(n + v)) / 2,
        mask * (change(n - v) + change(n + v)) / 2,
        -(normal * q).sum(-1).detach(),
        1 / x.amin(-1),
        1 / x.amax(-1),
        at.amin(-2).masked_fill(behind, -torch.inf),
        at.amax(-2).masked_fill(behind, torch.inf),
        eyes,
    )
