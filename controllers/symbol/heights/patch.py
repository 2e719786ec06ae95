"""Inverse ray tracing (T 9.4): a symbol drawn on a patch of the road that is believed, so that the eye sees it as on the plane z = 0."""

from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.symbol.heights.height_map import HeightMap
from luxloop.controllers.symbol.sensing.planes import LEAST_HEIGHT_M, below_lamps, holding, placed
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.world.frames import inverse, pose, transform

CELLS = (256, 256)  # along and across: finer than the texels of a lamp
FOLLOWED = 4  # light is followed for every fourth cell along and across, and interpolated between them
SAMPLES = (33, 17)  # of the symbol, along and across, whose light the patch must hold
BEYOND = (0.4, 0.15)  # of the symbol's length and width, how far light may cross the plane z = 0 beyond it for a patch of that plane
HIGHEST_M = 0.2  # of a road: a higher one gets a patch that is fitted to it
LEAST_DEPTH_M = 0.05  # above and below a fitted patch, where the road is looked for at least


def drawn_on(relief: HeightMap, lamps: Tensor, symbol: SymbolParams, T_body_ground: Tensor, in_place: bool = False) -> ProjectionCommand:
    """The symbol, on a rectangle on the road, warped such that the eye sees on the relief what it would see on the plane.

    lamps: `[m, 3]` m. T_body_ground: `[4, 4]`; relief and lamps are in the ground frame, the projection is in that of the body. The light
    of a cell takes what of the symbol lies where the eye sees that light on the plane, or where the light is itself if the symbol shall lie
    in_place. What is brighter than the plane would be is dimmed.
    """
    lamps = lamps.to(relief.heights)
    T, size_m, depth_m = _patch(relief, lamps, symbol, in_place)
    rows, cols = (n // FOLLOWED for n in CELLS)
    # Centres of blocks of FOLLOWED cells along and across, [rows], [cols] m.
    x, y = (length * (0.5 - (torch.arange(n).to(lamps) + 0.5) / n) for length, n in zip(size_m, (rows, cols), strict=True))
    cells = torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros(rows, cols).to(lamps)])  # [3, rows, cols]
    points = transform(T, cells.flatten(1)).view_as(cells)
    # Each lamp's light on the plane, [m, rows, cols] each.
    x_seen, y_seen = torch.stack([torch.stack(relief.seen_from(lamp, points, T[:3, 2], depth_m)) for lamp in lamps]).unbind(1)
    brightness = relief.at(relief.brightness, x_seen.flatten(0, 1), y_seen.flatten(0, 1)).view_as(x_seen)
    if in_place:
        x_seen, y_seen, _ = relief.points(x_seen, y_seen)
    source = [2 * (symbol.y_m - y_seen) / symbol.width_m, 2 * (symbol.x_m - x_seen) / symbol.length_m]  # u, v in -1..1
    coarse = torch.stack([*source, 1 / brightness.clamp(min=1)], 1)  # [m, 3, rows, cols]
    down, right = (_finer(n, coarse.dtype, coarse.device) for n in (rows, cols))
    fine = down @ coarse @ right.T  # [m, 3, *CELLS]
    return ProjectionCommand(*placed(T_body_ground.to(T) @ T), Warp(fine[:, :2], fine[:, 2], size_m))


def _patch(relief: HeightMap, lamps: Tensor, symbol: SymbolParams, in_place: bool) -> tuple[Tensor, tuple[float, float], float]:
    """A rectangle that holds the light to all of the symbol: on the plane z = 0, else on the plane that fits the road behind it best.

    Returns its pose `[4, 4]`, its length and width, and how far the road is above or below it at most, in m. The plane z = 0 goes first,
    since edges across and along the road stay along the cells of its patch.
    """
    along, across = (torch.linspace(-0.5, 0.5, n).to(lamps) for n in SAMPLES)
    # The symbol's points, [33, 17] m each.
    x, y = torch.broadcast_tensors((symbol.x_m + symbol.length_m * along)[:, None], symbol.y_m + symbol.width_m * across)
    road = (torch.stack([x, y, relief.under(x, y)[0]]) if in_place else relief.points(x, y)).flatten(1)  # [3, k]
    level, size = pose(lamps.new_tensor([symbol.x_m, symbol.y_m, 0.0]), torch.eye(3).to(lamps)), (symbol.length_m, symbol.width_m)
    reach = lamps.new_tensor([length * (0.5 + beyond) for length, beyond in zip(size, BEYOND, strict=True)])
    low, high, depth = _crossings(level, road, lamps)
    if depth < HIGHEST_M and bool((low > -reach).all() & (high < reach).all()):
        return *holding(level, low, high), HIGHEST_M
    T = _fitted(road, lamps)
    low, high, depth = _crossings(T, road, lamps)
    return *holding(T, low, high), depth + LEAST_DEPTH_M


def _crossings(T: Tensor, road: Tensor, lamps: Tensor) -> tuple[Tensor, Tensor, float]:
    """Where the ways of light to points `[3, k]` cross the plane of a patch at `[4, 4]`: least and greatest x and y, `[2]` m, in its frame.

    The last is how far the points are above or below it at most.
    """
    local, origins = transform(inverse(T), road), transform(inverse(T), lamps.T).T  # [3, k], [m, 3]
    fall = (origins[:, 2:] - local[2]).clamp(min=LEAST_HEIGHT_M)
    ways = torch.stack([local[k] + (local[k] - origins[:, k, None]) * (local[2] / fall) for k in (0, 1)]).flatten(1)  # [2, m * k]
    return ways.amin(1), ways.amax(1), float(local[2].abs().max())


def _fitted(road: Tensor, lamps: Tensor) -> Tensor:
    """Pose `[4, 4]` on the plane that fits points `[3, k]` best, no steeper than lamps can light it."""
    centre = road.mean(1, keepdim=True)
    x, y, z = road - centre
    # on a CPU the default driver, gelsy, reads pivots that torch leaves unset
    slope_x, slope_y = torch.linalg.lstsq(torch.stack([x, y], 1), z[:, None], driver="gels").solution[:, 0]  # z = s_x x + s_y y
    return below_lamps(centre[:, 0], slope_x, slope_y, lamps)


@lru_cache(maxsize=4)
def _finer(n: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Matrix `[n * FOLLOWED, n]` of linear interpolation between the centres of blocks of FOLLOWED cells."""
    each = torch.eye(n, dtype=dtype, device=device)[None, None]
    return interpolate(each, scale_factor=(FOLLOWED, 1), mode="bilinear")[0, 0]
