"""Anamorphic symbols, which look undistorted for an observer (T 7.2.2, fig. 7.8, 7.9, 7.16).

The flying symbol is a rectangle in space between observer and road. Each point of the road shows the point of the flying symbol on the line
from the observer's eye; the primitive on the road must only be large enough.
"""

import torch
from torch import Tensor


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
