"""The project's only ray caster: embree scenes of the road, of standing and of moving bodies, and of what could throw a shadow."""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from luxloop.world.caches import Part
from luxloop.world.frames import View
from luxloop.world.scene.embree import EmbreeMesh
from luxloop.world.scene.triangles import Hits, Triangles, intersect, on_planes

COLUMNS, ROWS = 256, 256  # of the grid over the directions of all points


def occlusion(triangles: Triangles, eye: Tensor, ways: Tensor, tolerance_m: float) -> tuple[Tensor, Tensor]:
    """Indices `[n]` of the points that something could hide, and far sides of the road that could `[M, 3 corners, 3]` m from the eye.

    The road is a surface z(x, y): a ray that goes below it comes out again through a face that is turned away from the eye, a *far side*.
    Only far sides and bodies hide points. Each marks the cells of a grid of directions that its bounding box covers, and those below, with
    its least depth. eye: `[3]` m. ways: `[3, N]` m, from the eye to the points. All float64.
    """
    far_sides = torch.cat([_far_sides(*group.road, eye) for group in triangles.groups])
    everything = torch.arange(ways.shape[1]), far_sides
    ahead = torch.nn.functional.normalize(ways[:2].mean(1), dim=0)
    R = torch.stack([torch.stack([ahead[0], ahead[1]]), torch.stack([-ahead[1], ahead[0]])])
    R = torch.block_diag(R, torch.ones(1, 1).double())  # to ahead, left and up
    x, y, z = R @ ways
    if not ways.shape[1] or float(x.amin()) <= 0:
        return everything
    across, up = y.div_(x), z.div_(x)
    (right, left), (bottom, top) = (torch.stack(each.aminmax()).tolist() for each in (across, up))
    column_width, row_height = max(left - right, 1e-9) / COLUMNS, max(top - bottom, 1e-9) / ROWS

    bodies = [(each.box - eye) @ R.T for each in triangles.off_road.placed]
    boxes = [(far_sides @ R.T).aminmax(dim=1)] + ([torch.stack(bodies).aminmax(dim=1)] if bodies else [])
    low, high = (torch.cat(each) for each in zip(*boxes, strict=True))  # [M + bodies, 3] m
    near, far = low[:, 0].clamp(min=0), high[:, 0]
    least = low[:, 1] / torch.where(low[:, 1] < 0, near, far)
    most, highest = (each / torch.where(each > 0, near, far) for each in (high[:, 1], high[:, 2]))
    hides = (far > 0) & (near < x.amax()) & (least <= left) & (most >= right) & (highest >= bottom)
    near, least, most, highest = (each[hides] for each in (near, least, most, highest))
    first, last = (((each - right) / column_width).clamp(0, COLUMNS - 1).long() for each in (least, most))
    row = ((top - highest) / row_height).clamp(0, ROWS - 1).long()
    columns = last - first + 1  # that each covers
    which = torch.repeat_interleave(columns)
    column = first[which] + torch.arange(len(which)) - (columns.cumsum(0) - columns)[which]
    grid = torch.full((COLUMNS * ROWS,), math.inf)
    grid.scatter_reduce_(0, column * ROWS + row[which], (near - tolerance_m).float()[which], "amin")
    nearest = grid.view(COLUMNS, ROWS).cummin(1).values.flatten()
    column = across.sub_(right).div_(column_width).int().clamp_(max=COLUMNS - 1)
    row = up.sub_(top).div_(-row_height).int().clamp_(max=ROWS - 1)
    return torch.nonzero(x > nearest[column * ROWS + row])[:, 0], far_sides[hides[: len(far_sides)]]


def _far_sides(corners: Tensor, planes: Tensor, eye: Tensor) -> Tensor:
    below = torch.nonzero(torch.cat([eye, eye.new_ones(1)]) @ planes < 0)[:, 0]
    return corners[below] - eye


TOLERANCE_M = 2e-3  # along the ray, within which a hit counts as the surface itself
BELOW_M = 1e-5  # across the face, for rounding in float32: a grazing ray meets it far before its point
BESIDE = 1e-4  # of a face, by which a ray may pass beside it
LIFT = 1e-7  # of the distance, by which points are raised for a second ray, since float32 puts some below the far side they are on
SPARE = 1 + 1e-5  # of depths, which embree finds in float32


class RayCaster:
    """A face source by ray casting, for machines without OpenGL and as a cross-check."""

    name = "embree"

    def face_ids(self, triangles: Triangles, view: View, part: Part | None = None) -> Tensor:
        """As of `FaceSource`."""
        view = view if part is None else view.within(*part)
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


def surfaces_met(triangles: Triangles, origins: Tensor, directions: Tensor) -> Iterator[Hits]:
    """The first faces that rays `[3, N]` from their own origins `[3, N]` m meet, at the faces' middles in barycentric coordinates."""
    face_ids, depth, _ = _cast(triangles, origins, directions, torch.tensor([torch.inf]))
    for first, placed in triangles.parts():
        rays = torch.nonzero((face_ids >= first) & (face_ids < first + placed.n_faces))[:, 0]
        middle, front = torch.full((3, len(rays)), 1 / 3, dtype=torch.float64), torch.ones(len(rays), dtype=torch.bool)
        yield Hits(placed, rays, face_ids[rays] - first, depth[rays], middle, front)


def depths(triangles: Triangles, face_ids: Tensor, origin: Tensor, directions: Tensor) -> Tensor:
    """Depth `[N]` float64 at which rays meet their faces, in lengths of their directions; infinite where there is none."""
    depth = torch.full(face_ids.shape, torch.inf, dtype=torch.float64)
    for hits in hits_on(triangles, face_ids, origin, directions):
        depth[hits.pixels] = hits.depth
    return depth


def sees(triangles: Triangles, eye: Tensor, points: Tensor, tolerance_m: float = TOLERANCE_M) -> Tensor:
    """Whether an eye or lamp at `[3]` m sees points `[..., 3, N]` in m, `[..., N]` bool.

    A body hides a point that lies behind its first face on the ray by more than the tolerance along the ray and `BELOW_M` across the face.
    The road hides a point that lies behind a far side of it, or on one. A point at NaN is not seen.
    """
    if not bool((there := ~points.isnan().any(-2)).all()):
        return there.masked_scatter(there, sees(triangles, eye, points.movedim(-2, 0)[:, there], tolerance_m))
    eye = eye.double().cpu()
    ways = points.double().cpu().movedim(-2, 0).flatten(1) - eye[:, None]  # [3, ... * N]
    visible = torch.ones(ways.shape[1], dtype=torch.bool)
    asked, far_sides = occlusion(triangles, eye, ways, tolerance_m)
    ways = ways[:, asked]
    distance = ways.square().sum(0).sqrt_()
    _, depth, across = _cast(triangles.off_road, eye, ways, (1 - tolerance_m / distance).float())
    hidden = ((1 - depth) * distance > tolerance_m) & ((1 - depth) * across > BELOW_M)
    if len(far_sides) and len(asked):
        faces = torch.arange(far_sides.shape[0] * 3).view(-1, 3).flip(1)  # so that far sides face the eye
        mesh = EmbreeMesh(far_sides.flatten(0, 1), faces, torch.zeros(len(faces), dtype=torch.bool))
        for lift in (0.0, LIFT):
            ways[2] += lift * distance
            hidden[mesh.cast(torch.zeros(3).double(), ways, torch.ones(len(asked)))[0]] = True
    visible[asked] = ~hidden
    return visible.to(points.device).view(points[..., 0, :].shape)


def _cast(triangles: Triangles, origin: Tensor, directions: Tensor, farthest: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """First faces, as `first_hits`, depths `[N]` float64 in lengths of the directions, and those lengths `[N]` across the face in m.

    origin: `[3]` or `[3, N]` m. farthest: `[N]` or `[1]` such lengths; faces that lie deeper need not be found.
    """
    nearest = torch.full((directions.shape[1],), -1)
    depth = torch.full((directions.shape[1],), torch.inf, dtype=torch.float64)
    across = torch.zeros_like(depth)
    origin, directions, first = origin.double(), directions.double(), 0
    for group in triangles.groups:
        mesh, T_mesh_world = group.embree
        local_origin = T_mesh_world[:3, :3] @ origin + T_mesh_world[:3, 3].view(3, *[1] * (origin.dim() - 1))
        local = T_mesh_world[:3, :3] @ directions
        limits = torch.minimum(farthest, (depth * SPARE).float())
        rays, faces, depths, acrosses = mesh.cast(local_origin, local, limits)
        closer = depths < depth[rays]
        rays = rays[closer]
        nearest[rays], depth[rays], across[rays] = faces[closer] + first, depths[closer], acrosses[closer]
        first += sum(each.n_faces for each in group.placed)
    return nearest, depth, across
