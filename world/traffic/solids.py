"""Surfaces of the models: capsules that melt into each other, and bevelled prisms."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxloop.world.traffic.shapes import Floats, Piece

RELAXATIONS: Final = 2
SQUARE: Final = ((0, 0), (1, 0), (1, 1), (0, 1))  # cells around an edge, counter-clockwise from its end


class Capsule(NamedTuple):
    """A tapering capsule of a part between two points `[3]`; radii in m."""

    part: str
    start: Floats
    stop: Floats
    r_start: float
    r_stop: float


def blend(capsules: Sequence[Capsule], cell_m: float, soft_m: float) -> list[Piece]:
    """One smooth surface of all capsules: where the sum of exp(-distance / soft_m) is 1. A face is of the part of the nearest capsule.

    Elastic surface nets (Gibson 1998) on a grid of cell_m: corners move in turn to the middle of their neighbours and onto the surface.
    """
    ends = np.array([(each.start, each.stop) for each in capsules])  # [N, 2, 3]
    radii = np.array([(each.r_start, each.r_stop) for each in capsules])  # [N, 2]
    low, high = (ends - radii[..., None]).min((0, 1)) - 2 * cell_m, (ends + radii[..., None]).max((0, 1)) + 2 * cell_m
    shape = np.ceil((high - low) / cell_m).astype(int) + 1
    total = np.zeros(shape)
    around = radii.max(1, keepdims=True) + 3 * soft_m + cell_m
    first = np.floor((ends.min(1) - around - low) / cell_m).astype(int).clip(0)
    last = np.minimum(np.ceil((ends.max(1) + around - low) / cell_m).astype(int) + 1, shape)
    for k in range(len(ends)):
        box = tuple(map(slice, first[k], last[k]))
        places = low + cell_m * np.stack(np.meshgrid(*map(np.arange, first[k], last[k]), indexing="ij"), -1)
        distance, _ = _distances(places.reshape(-1, 3), ends[k : k + 1], radii[k : k + 1], soft_m)
        total[box] += np.exp(-distance / soft_m).reshape(total[box].shape)
    vertices, faces = _surface_nets(total > 1)
    vertices = low + cell_m * vertices
    for _ in range(RELAXATIONS):
        around = np.zeros_like(vertices)
        for k in (1, 2):
            np.add.at(around, faces, vertices[np.roll(faces, k, 1)])
        vertices = around / (2 * np.bincount(faces.ravel(), minlength=len(vertices))[:, None])
        distance, outwards = _distances(vertices, ends, radii, soft_m)
        depth = soft_m * np.log(np.exp(-distance / soft_m).sum(1, keepdims=True))
        vertices = vertices + (depth * outwards / np.square(outwards).sum(1, keepdims=True).clip(0.1)).clip(-cell_m, cell_m)
    corners = vertices[faces]
    distance, outwards = _distances(corners.mean(1), ends, radii, soft_m)
    folded = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * outwards).sum(1) < 0
    faces[folded] = faces[folded, ::-1]  # slivers, which have to look outwards, too
    names = np.array([each.part for each in capsules])[distance.argmin(1)]
    return [Piece(part, vertices, faces[names == part]) for part in dict.fromkeys(names.tolist())]


def _distances(points: Floats, ends: Floats, radii: Floats, soft_m: float) -> tuple[Floats, Floats]:
    """Distances `[V, N]` m of points `[V, 3]` to the surfaces of capsules, and the way out of all of them, `[V, 3]`."""
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    square = np.square(way).sum(1).clip(1e-12)
    along = points @ way.T - (start * way).sum(1)
    share = (along / square).clip(0, 1)
    away = np.square(points).sum(1)[:, None] - 2 * points @ start.T + np.square(start).sum(1)
    length = np.sqrt((away - share * (2 * along - share * square)).clip(1e-12))
    distance = length - radii[:, 0] - share * (radii[:, 1] - radii[:, 0])
    weight = np.exp((distance.min(1, keepdims=True) - distance) / soft_m)
    weight /= weight.sum(1, keepdims=True) * length
    return distance, points * weight.sum(1, keepdims=True) - weight @ start - (weight * share) @ way


def _surface_nets(inside: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices `[V, 3]` in cells and faces `[F, 3]` around the points of a grid that are inside; none on the grid's border may be."""
    corners = sum(
        inside[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None].astype(int) for i in (0, 1) for j in (0, 1) for k in (0, 1)
    )
    cells = np.argwhere((corners > 0) & (corners < 8))
    number = np.zeros(inside.shape, int)
    number[tuple(cells.T)] = np.arange(len(cells))
    quads = []
    for axis in range(3):
        u, v = np.roll(np.eye(3, dtype=int), -axis - 1, axis=0)[:2]
        ahead = np.roll(inside, -1, axis)
        for leaves, order in ((inside & ~ahead, SQUARE), (~inside & ahead, SQUARE[::-1])):
            edges = np.argwhere(leaves)
            quads.append(np.stack([number[tuple((edges - a * u - b * v).T)] for a, b in order], 1))
    corner = np.concatenate(quads).astype(np.int64)
    return np.asarray(cells + 0.5, np.float64), np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])


def prism(part: str, profile: ArrayLike, half_m: float, bevel_m: float = 0.03, y_m: float = 0.0, tapers_m: float = 0.0) -> Piece:
    """A body of a convex side view `[n, 2]` (x, z), with bevelled edges and flat faces.

    half_m: half its width. y_m: of its middle. tapers_m: by which half the width is less at the top.
    """
    side = np.asarray(profile, float)
    inwards = side.mean(0) - side
    inner = side + bevel_m * inwards / np.linalg.norm(inwards, axis=1, keepdims=True)
    height = side[:, 1]
    taper = tapers_m * (height - height.min()) / np.ptp(height)
    rings = [
        np.column_stack([at[:, 0], y_m + sign * (half - taper), at[:, 1]])
        for at, half in ((side, half_m - bevel_m), (inner, half_m))
        for sign in (-1, 1)
    ]
    return hull(part, np.concatenate(rings))


def hull(part: str, points: ArrayLike) -> Piece:
    """The convex hull of points `[n, 3]`, with flat faces."""
    import trimesh

    faces = np.array(trimesh.convex.convex_hull(np.asarray(points, float)).triangles)
    return Piece(part, faces.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))


def box(part: str, low: ArrayLike, high: ArrayLike, bevel_m: float = 0.01) -> Piece:
    """A bevelled box between two corners `[3]`."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, float), np.asarray(high, float)
    return prism(part, [(x0, z0), (x1, z0), (x1, z1), (x0, z1)], (y1 - y0) / 2, bevel_m, (y0 + y1) / 2)
