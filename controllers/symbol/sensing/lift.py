"""Projections for a road of a shape that is known: on it the eye sees what it would see of the same drawing on the plane z = 0.

All light of a lamp leaves one point, and all lines of sight end in another. So light is followed to the road, from there along the line of
sight to the plane z = 0, and is what the lamp would send to that place of the plane. A step of the projection's pose then moves what is
seen as far as it does on the plane.
"""

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.symbol.sensing.planes import below_lamps, holding, placed
from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.shape import reached
from luxloop.world.frames import inverse, pose, rotation, transform
from luxloop.world.texels import resample

FOLLOWED = 4  # light is followed for every fourth cell along and across, and interpolated between them
FARTHEST, NOWHERE = 3.0, 1e3  # of the way to the plane z = 0 and to the patch: where lines of sight and light end that meet no road
LEAST_FALL_M = 1e-3  # of lines over what they cross


def lifted(
    projection: ProjectionCommand, size_m: tuple[float, float], shape: Tensor, x0_m: float, eye: Tensor, lamps: Tensor
) -> ProjectionCommand:
    """A drawing of a symbol of `size_m` (length, width) on the plane, as one on a rectangle tangent to a road of a shape `[4]` about x0.

    eye: `[3]`, lamps: `[m, 3]` m. Each lamp has a warp of its own.
    """
    length, width = size_m if projection.warp is None else projection.warp.size_m
    T = _rectangle(projection)
    corners = lamps.new_tensor([[length, length, -length, -length], [width, -width, width, -width], [0.0] * 4]) / 2
    ways = torch.stack([_crossed(lamp, transform(T, corners)) for lamp in lamps], 1) - eye[:, None, None]  # [3, m, 4]
    road = eye[:, None, None] + ways * reached(shape[None], x0_m, eye, ways)[0].clamp(max=FARTHEST)
    patch, size = _patch(road, shape, x0_m, lamps)
    rows, cols = (n // FOLLOWED for n in CELLS)
    x, y = (extent * (0.5 - (torch.arange(n).to(lamps) + 0.5) / n) for extent, n in zip(size, (rows, cols), strict=True))
    cells = torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros(rows, cols).to(lamps)]).flatten(1)
    places = []
    for lamp in lamps:
        ways = transform(patch, cells) - lamp[:, None]
        road = lamp[:, None] + ways * reached(shape[None], x0_m, lamp, ways)[0].clamp(max=NOWHERE)
        lamp_there, seen = (transform(inverse(T), points) for points in (lamp[:, None], _crossed(eye, road)))
        x_there, y_there, _ = _crossed(lamp_there[:, 0], seen)
        places.append(torch.stack([-2 * y_there / width, -2 * x_there / length]).view(2, rows, cols))
    source = interpolate(torch.stack(places), scale_factor=FOLLOWED, mode="bilinear")
    return ProjectionCommand(*placed(patch), _warped(projection.warp, source, size))


def _rectangle(projection: ProjectionCommand) -> Tensor:
    """Pose `[4, 4]` of a projection's rectangle."""
    x, y, roll, pitch = projection.pose
    z = torch.zeros_like(x) if projection.z is None else projection.z
    return pose(torch.stack([x, y, z]), rotation(roll, pitch))


def _crossed(origin: Tensor, points: Tensor) -> Tensor:
    """Where lines from an origin `[3]` m through points `[3, ...]` m cross z = 0; far ahead for lines that do not fall."""
    start = origin.view(3, *(1,) * (points.dim() - 1))
    return start + (points - start) * (origin[2] / (origin[2] - points[2]).clamp(min=LEAST_FALL_M))


def _patch(road: Tensor, shape: Tensor, x0_m: float, lamps: Tensor) -> tuple[Tensor, tuple[float, float]]:
    """Pose `[4, 4]`, length and width in m of a rectangle that all light of lamps to points `[3, m, k]` of the road crosses.

    It is tangent to the road behind their middle, but no steeper than lamps can light it.
    """
    _, b, c, d = shape
    middle = road.flatten(1).mean(1)
    T = below_lamps(middle, b + d * (middle[0] - x0_m), c, lamps)
    local, origins = transform(inverse(T), road.flatten(1)).view_as(road), transform(inverse(T), lamps.T).T
    crossings = torch.stack([_crossed(origin, points)[:2] for origin, points in zip(origins, local.unbind(1), strict=True)], 1)
    low, high = crossings.flatten(1).aminmax(dim=1)
    return holding(T, low, high)


def _warped(warp: Warp | None, source: Tensor, size_m: tuple[float, float]) -> Warp:
    """A warp on the rectangle whose cells take the light of places `[m, 2, h, w]` on the rectangle of another, or on the symbol."""
    if warp is None:
        return Warp(source, torch.ones_like(source[:, 0]), size_m)
    u, v = source.unbind(1)
    of, dimming = (each.expand(len(u), -1, -1, -1) for each in (warp.source, warp.dimming[:, None]))
    taken = resample(of, u, v, "border")
    dimmed = resample(dimming, u, v)
    return Warp(taken, dimmed[:, 0], size_m)
