"""The project's only ray caster: embree through trimesh, each body in its own frame, so that nothing is rebuilt when a body moves."""

import math

import torch
from torch import Tensor

from world.frames import inverse
from world.scene.triangles import Triangles
from world.view import View

TOLERANCE_M = 2e-3  # by which a surface lies before itself: what OpenGL interpolates is 1 mm off where light grazes a road 60 m ahead
MARGIN_M = 1e-3  # around a body, which may be flat
ROUNDING = 1e-5  # of products in float32, as a share of them


class RayCaster:
    """A face source by ray casting, where no OpenGL is to be had and as its cross-check."""

    name = "embree"

    def face_ids(self, triangles: Triangles, view: View) -> Tensor:
        """Id of the nearest face through each pixel's centre, `[height, width]` int64, -1 where there is none."""
        return first_hits(triangles, view.origin, view.rays().flatten(1)).reshape(view.height, view.width)


def first_hits(triangles: Triangles, origin: Tensor, directions: Tensor) -> Tensor:
    """Id of the first face that each ray meets, `[N]` int64, -1 where there is none.

    origin: `[3]` m, common to all rays. directions: `[3, N]`, any length. Embree computes in float32: good to some 1e-6 of a body's size.
    """
    return _cast(triangles, origin, directions, torch.tensor([torch.inf]))[0]


def sees(triangles: Triangles, eye: Tensor, points: Tensor, tolerance_m: float = TOLERANCE_M) -> Tensor:
    """Which points `[..., 3, N]` in m an eye or a lamp at `[3]` m has in sight, `[..., N]` bool.

    Hidden is what lies deeper than the first face on the way to it, by more than the tolerance along the ray.
    """
    eye = eye.double().cpu()
    ways = points.double().cpu().movedim(-2, 0).flatten(1) - eye[:, None]
    distance = ways.square().sum(0).sqrt_()
    _, depth = _cast(triangles, eye, ways, (1 - tolerance_m / distance).float())
    return ((1 - depth) * distance <= tolerance_m).to(points.device).view(points[..., 0, :].shape)


def _cast(triangles: Triangles, origin: Tensor, directions: Tensor, farthest: Tensor) -> tuple[Tensor, Tensor]:
    """The first faces, as `first_hits`, and their depths `[N]` float64 in lengths of the directions.

    farthest: `[N]` or `[1]` such lengths; faces that lie deeper need not be found.
    """
    nearest = torch.full((directions.shape[1],), -1)
    depth = torch.full((directions.shape[1],), torch.inf, dtype=torch.float64)
    ways = directions.float()
    squares, farthest = ways.square().sum(0), farthest.expand(directions.shape[1])
    for first, placed in triangles.parts():
        T_body_world, body = inverse(placed.T_world_body), placed.body
        local_origin = T_body_world[:3, :3] @ origin + T_body_world[:3, 3]
        rays = torch.nonzero(_towards(body.bounds, placed.T_world_body, origin, ways, squares, farthest))[:, 0]
        local = T_body_world[:3, :3] @ directions.index_select(1, rays)
        near = torch.nonzero(_near(body.bounds, local_origin, local, farthest[rays]))[:, 0]
        rays, local = rays[near], local.index_select(1, near)
        if not len(rays):
            continue
        face = torch.from_numpy(body.intersector.intersects_first(local_origin.expand(len(rays), 3).numpy(), local.T.numpy())).long()
        normal, offset = body.planes[face].T.split((3, 1))
        towards = (normal * local).sum(0)
        hit_depth = (offset[0] - local_origin @ normal) / towards
        closer = (face >= 0) & (hit_depth < depth[rays])
        if not body.two_sided:  # from within a closed body, one sees out
            closer &= towards < 0
        nearest[rays[closer]] = face[closer] + first
        depth[rays[closer]] = hit_depth[closer]
    return nearest, depth


def _towards(bounds: Tensor, T_world_body: Tensor, origin: Tensor, ways: Tensor, squares: Tensor, farthest: Tensor) -> Tensor:
    """Which rays `[3, N]` of squared length `[N]` may meet a body: cheap tests, which most do not pass.

    Of a ball around its box; for rays that start within, of how far they go towards the slabs of the box in the world.
    """
    middle, half = bounds.mean(0), (bounds[1] - bounds[0]) / 2
    away = T_world_body[:3, :3] @ middle + T_world_body[:3, 3] - origin
    beyond = float(away @ away - half @ half)
    if beyond > 0:
        along = away.float() @ ways
        return (along > 0) & (along.square_() >= (1 - ROUNDING) * beyond * squares)
    towards = torch.ones_like(squares, dtype=torch.bool)
    for way, gap, reach_m in zip(ways, away.tolist(), (T_world_body[:3, :3].abs() @ half).tolist(), strict=True):
        if abs(gap) > reach_m:  # the origin lies beside this slab
            towards &= way * farthest * math.copysign(1.0, gap) >= (abs(gap) - reach_m) * (1 - ROUNDING)
    return towards


def _near(bounds: Tensor, origin: Tensor, directions: Tensor, farthest: Tensor) -> Tensor:
    """Which rays `[3, N]` pass through the box around a body: most miss a small one, and asking embree costs more."""
    low, high = (bounds - origin + bounds.new_tensor([[-MARGIN_M], [MARGIN_M]])).float()
    per_m = 1 / directions.float()
    crossings = low[:, None] * per_m, high[:, None] * per_m  # of the six planes; 0 / 0 where a ray lies in one
    entering, leaving = torch.fmin(*crossings).amax(0).clamp(min=0), torch.fmax(*crossings).amin(0).minimum(farthest)
    return (entering <= leaving) & (entering < torch.inf)
