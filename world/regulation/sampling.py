"""Points at which a segment or a zone is looked at, all as `[2, N]` of h and v in deg, float64."""

import math

import torch
from torch import Tensor

from luxloop.world.regulation.tables import Point

MOST_SAMPLES = 400_000  # of a zone; a larger one is sampled more coarsely and refined around its extremes
EXTREMES = 8  # samples around which the search is refined
FINER = 10


def segment(start: Point, end: Point, step_deg: float) -> Tensor:
    n = max(math.ceil(math.dist(start, end) / step_deg), 1)
    share = torch.linspace(0, 1, n + 1, dtype=torch.float64)
    a, b = (torch.tensor(point, dtype=torch.float64)[:, None] for point in (start, end))
    return a + (b - a) * share


def cells(box: tuple[Point, ...], step_deg: float) -> Tensor:
    """The middles of the cells of a box, given by two opposite corners."""
    low, high = box
    h, v = (a + (torch.arange(round((b - a) / step_deg), dtype=torch.float64) + 0.5) * step_deg for a, b in zip(low, high, strict=True))
    return torch.cartesian_prod(h, v).T


def zone(corners: tuple[Point, ...], step_deg: float) -> Tensor:
    """The outline and the inside of a polygon."""
    step = _affordable(corners, step_deg)
    lines = [segment(a, b, step) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    (h0, v0), (h1, v1) = (tuple(map(extreme, zip(*corners, strict=True))) for extreme in (min, max))
    h, v = segment((h0, 0.0), (h1, 0.0), step)[0], segment((0.0, v0), (0.0, v1), step)[1]
    points = torch.cartesian_prod(h, v).T
    return torch.cat([*lines, points[:, _inside(corners, points)]], 1)


def around(corners: tuple[Point, ...], points: Tensor, values: Tensor, step_deg: float) -> Tensor:
    """Finer samples, within the polygon, around the points where values `[N]` are largest."""
    step = _affordable(corners, step_deg)
    highest = points[:, values.topk(min(EXTREMES, len(values))).indices]
    offset = torch.linspace(-step, step, 2 * FINER + 1, dtype=torch.float64)
    fine = (highest[:, :, None] + torch.cartesian_prod(offset, offset).T[:, None]).flatten(1)
    return fine[:, _inside(corners, fine)]


def _affordable(corners: tuple[Point, ...], step_deg: float) -> float:
    """The step wanted, or the coarser one that keeps to MOST_SAMPLES."""
    width, height = (max(axis) - min(axis) for axis in zip(*corners, strict=True))
    return max(step_deg, math.sqrt(width * height / MOST_SAMPLES))


def _inside(corners: tuple[Point, ...], points: Tensor) -> Tensor:
    """Which points `[2, N]` the polygon holds, by the even-odd rule; points on its outline may go either way."""
    h, v = points
    held = torch.zeros(points.shape[1], dtype=torch.bool)
    for (h0, v0), (h1, v1) in zip(corners, corners[1:] + corners[:1], strict=True):
        if v0 != v1:
            held ^= ((v0 > v) != (v1 > v)) & (h < h0 + (v - v0) * (h1 - h0) / (v1 - v0))
    return held
