"""The project's only ray caster: embree through trimesh, each body in its own frame, so that nothing is rebuilt when a body moves."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from luxloop.world.frames import View
from luxloop.world.scene.triangles import Hits, Instance, Triangles, intersect, on_planes

TOLERANCE_M = 2e-3  # by which a surface lies before itself, along the ray
BELOW_M = 1e-5  # and across its face, to float32: a ray that grazes it would meet a point there far before itself
MARGIN_M = 1e-3  # around a body, which may be flat
BESIDE = 1e-4  # of a face, by which a ray may pass beside it
NEAREST_M = 1e-6  # to the origin of rays
STEEPEST = 1e3  # slope beside the axis that most rays follow; steeper ones are compared with every box
ROUNDING = 1e-5  # of products in float32, as a share of them
FARTHEST = 1e30  # lengths of a ray's direction, of which no product is infinite
TOGETHER = 64  # neighbouring rays that are first compared with a box together


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


def hits_on(triangles: Triangles, face_ids: Tensor, origin: Tensor, directions: Tensor) -> Iterator[Hits]:
    """Intersect rays with the faces that a face source found, as `intersect` does, which says more.

    OpenGL snaps corners to 1/256 px or so: where a ray passes beside its face, the first one that it meets takes its place.
    """
    beside = [face_ids.new_empty(0)]
    for hits in on_planes(triangles, face_ids, origin, directions):
        on = hits.barycentric.amin(0) >= -BESIDE
        beside.append(hits.pixels[~on])
        yield hits.only(on) if len(beside[-1]) else hits
    pixels = torch.cat(beside)
    directions = directions[:, pixels]
    for hits in intersect(triangles, first_hits(triangles, origin, directions), origin, directions):
        yield replace(hits, pixels=pixels[hits.pixels])


def depths(triangles: Triangles, face_ids: Tensor, origin: Tensor, directions: Tensor) -> Tensor:
    """Depth `[N]` float64 at which rays meet their faces, in lengths of their directions; infinite where there is none."""
    depth = torch.full(face_ids.shape, torch.inf, dtype=torch.float64)
    for hits in hits_on(triangles, face_ids, origin, directions):
        depth[hits.pixels] = hits.depth
    return depth


def sees(triangles: Triangles, eye: Tensor, points: Tensor, tolerance_m: float = TOLERANCE_M) -> Tensor:
    """Which points `[..., 3, N]` in m an eye or a lamp at `[3]` m has in sight, `[..., N]` bool.

    Hidden is what lies deeper than the first face on the way to it, by more than the tolerance along the ray and `BELOW_M` across the face.
    """
    eye = eye.double().cpu()
    ways = points.double().cpu().movedim(-2, 0).flatten(1) - eye[:, None]  # [3, ... * N]
    distance = ways.square().sum(0).sqrt_()
    _, depth, across = _cast(triangles, eye, ways, (1 - tolerance_m / distance).float())
    hidden = ((1 - depth) * distance > tolerance_m) & ((1 - depth) * across > BELOW_M)
    return (~hidden).to(points.device).view(points[..., 0, :].shape)


def _cast(triangles: Triangles, origin: Tensor, directions: Tensor, farthest: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """First faces, as `first_hits`, depths `[N]` float64 in lengths of the directions, and those lengths `[N]` across the face in m.

    farthest: `[N]` or `[1]` such lengths; faces that lie deeper need not be found.
    """
    nearest = torch.full((directions.shape[1],), -1)
    depth = torch.full((directions.shape[1],), torch.inf, dtype=torch.float64)
    across = torch.zeros_like(depth)
    farthest = farthest.expand(directions.shape[1])
    for (first, placed), rays in zip(triangles.parts(), _towards(triangles.placed, origin, directions.float(), farthest), strict=True):
        if not len(rays):
            continue
        T_body_world, body = placed.T_body_world, placed.body
        local_origin = T_body_world[:3, :3] @ origin + T_body_world[:3, 3]  # o [3]
        local = T_body_world[:3, :3] @ directions.index_select(1, rays)  # d [3, rays]
        near = torch.nonzero(_near(body.bounds, local_origin, local, farthest[rays]))[:, 0]
        rays, local = rays[near], local.index_select(1, near)
        if not len(rays):
            continue
        face = torch.from_numpy(body.intersector.intersects_first(local_origin.expand(len(rays), 3).numpy(), local.T.numpy())).long()
        normal, offset = body.planes[face].T.split((3, 1))  # n x = c, [3, rays], [1, rays]
        towards = (normal * local).sum(0)
        hit_depth = (offset[0] - local_origin @ normal) / towards  # t where n (o + t d) = c, [rays]
        closer = (face >= 0) & (hit_depth < depth[rays])
        if not body.two_sided:  # from within a closed body, one sees out
            closer &= towards < 0
        nearest[rays[closer]] = face[closer] + first
        depth[rays[closer]] = hit_depth[closer]
        across[rays[closer]] = (towards.abs() / normal.norm(dim=0))[closer]
    return nearest, depth, across


def _towards(placed: Sequence[Instance], origin: Tensor, ways: Tensor, farthest: Tensor) -> Iterator[Tensor]:
    """Indices of the rays `[3, N]` that may meet each body: cheap tests, which most do not pass, first of several rays at once.

    Of how far they go towards the sides of the box around it in the world; and of where this box is to a camera at the origin that looks
    along the axis which most rays follow.
    """
    if not placed or not ways.shape[1]:
        yield from (torch.empty(0, dtype=torch.int64) for _ in placed)
        return
    along = ways.mean(1)
    axis = int(along.abs().argmax())
    sides, sign = [each for each in range(3) if each != axis], math.copysign(1.0, along[axis])
    ahead = sign * ways[axis]
    reached = torch.cat([ways[sides] / ahead, ways * farthest.clamp(max=FARTHEST)])  # slopes and ends of the rays, [5, N]
    aside = torch.nonzero((ahead <= 0).logical_or_((reached[:2].abs() > STEEPEST).any(0)))[:, 0]
    reached[:, aside] = torch.inf  # no slope that a body admits
    low, high = _ray_limits(placed, origin, axis, sides, sign)  # [n, 5] each
    padded = pad(reached, (0, -reached.shape[1] % TOGETHER), value=torch.inf).unflatten(1, (-1, TOGETHER))  # [5, m, TOGETHER]
    least, most = padded.amin(-1), padded.amax(-1)  # [5, m] each
    near = ((most >= low[:, :, None]) & (least <= high[:, :, None])).all(1)  # [n, m]
    place = torch.arange(padded[0].numel()).view(-1, TOGETHER)
    for some, lowest, highest in zip(near, low, high, strict=True):
        rays = place[some].flatten()
        of_these = padded[:, some].flatten(1)
        met = rays[((of_these >= lowest[:, None]) & (of_these <= highest[:, None])).all(0)]
        yield torch.cat([met, aside]) if len(aside) else met


def _ray_limits(placed: Sequence[Instance], origin: Tensor, axis: int, sides: list[int], sign: float) -> tuple[Tensor, Tensor]:
    """Least and most `[n, 5]` float32 of the two slopes and three ends of rays that may meet each body's box."""
    corners = torch.stack([each.box for each in placed]) - origin  # [n, 8, 3]
    low, high = corners.amin(1), corners.amax(1)  # [n, 3] each
    depths = sign * torch.stack([low, high], 1)[:, :, axis]  # [n, 2]
    edges = (torch.stack([low, high], 1)[:, :, None, sides] / depths.clamp(min=NEAREST_M)[:, None, :, None]).flatten(1, 2)  # [n, 4, 2]
    spare = ROUNDING * (1 + edges.abs())
    ends_low = torch.where(low > 0, low * (1 - ROUNDING), -torch.inf)
    ends_high = torch.where(high < 0, high * (1 - ROUNDING), torch.inf)
    least, most = torch.cat([(edges - spare).amin(1), ends_low], 1), torch.cat([(edges + spare).amax(1), ends_high], 1)
    least[depths.amax(1) <= 0] = torch.inf
    return least.float(), most.float()


def _near(bounds: Tensor, origin: Tensor, directions: Tensor, farthest: Tensor) -> Tensor:
    """Which rays `[3, N]` pass through the box around a body: most miss a small one, and asking embree costs more."""
    low, high = (bounds - origin + bounds.new_tensor([[-MARGIN_M], [MARGIN_M]])).float()  # [3] each
    per_m = 1 / directions.float()
    crossings = low[:, None] * per_m, high[:, None] * per_m  # of the six planes; 0 / 0 where a ray lies in one
    entering, leaving = torch.fmin(*crossings).amax(0).clamp(min=0), torch.fmax(*crossings).amin(0).minimum(farthest)
    return (entering <= leaving) & (entering < torch.inf)  # slab test: the last plane is entered before the first is left, [N]
