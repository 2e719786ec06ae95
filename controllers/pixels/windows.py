"""The windows of a light texture that primitives can touch: bounding rectangles of their projected outlines.

The rectangles are tighter than the ellipsoids around groups in T 7.3.3, and cull all rays of a primitive at once.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple

from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives
from luxloop.world.texels import NOWHERE, TexelGrid, Window

NEAREST_M = 1e-3  # distance ahead of the photometric centre at which primitives that reach behind the lamp are clipped
SLACK = 0.01  # texels, margin for rounding
BANDS = 4  # number of row bands of a window
BANDS_SLACK = 0.05  # texels, margin for rounding
Point = tuple[float, float, float]


def whole(grid: TexelGrid) -> Window:
    """The whole light texture as a window."""
    return Window(0, grid.rows, 0, grid.cols)


def union(windows: Sequence[Window]) -> Window:
    """The smallest window around all non-empty windows."""
    lit = [astuple(window) for window in windows if not window.empty]
    if not lit:
        return NOWHERE
    v, v_stop, u, u_stop = zip(*lit, strict=True)
    return Window(min(v), max(v_stop), min(u), max(u_stop))


def projected_windows(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor, fringe: Sequence[bool] = ()) -> list[Window]:
    """The texels that each primitive of a single scene can touch, by its projected outline ahead of the lamp.

    fringe: primitives that reach one texel beyond their outline, by default none. The windows go to the host, which would synchronise an
    accelerator.
    """
    corners = _corners(primitives, T_world_headlight)
    return [_window(outline, grid, fringed) for outline, fringed in zip(corners, fringe or [False] * len(primitives), strict=True)]


def _corners(primitives: Primitives, T_world_headlight: Tensor) -> list[list[list[float]]]:
    """Corners `[P, 4, 3]` m in the headlight's frame."""
    T = T_world_headlight.to(primitives.origin)
    corners: list[list[list[float]]] = ((primitives.corners().detach() - T[:3, 3]) @ T[:3, :3]).tolist()
    return corners


def _window(corners: list[list[float]], grid: TexelGrid, fringed: bool) -> Window:
    a, b, c, d = ((x, y, z) for x, y, z in corners)
    points = _before_the_lamp([a, b, d, c])  # around the outline
    if not points:
        return NOWHERE
    if fringed and min(x for x, _, _ in corners) < NEAREST_M:
        return whole(grid)
    row = [(grid.top - z / x) / (grid.top - grid.bottom) * grid.rows for x, _, z in points]
    col = [(grid.left - y / x) / (grid.left - grid.right) * grid.cols for x, y, _ in points]
    r0, r1 = _centres(min(row), max(row), grid.rows, fringed)
    c0, c1 = _centres(min(col), max(col), grid.cols, fringed)
    return Window(r0, r1, c0, c1) if r1 > r0 and c1 > c0 else NOWHERE


def _centres(low: float, high: float, n: int, fringed: bool) -> tuple[int, int]:
    """First texel and the texel after the last whose centres lie from low to high; fringed: with one texel more on both sides."""
    reach = fringed + SLACK - 0.5
    return math.ceil(min(max(low - reach - 1, 0.0), n)), math.floor(min(max(high + reach, -1.0), n - 1.0)) + 1


def _before_the_lamp(outline: list[Point]) -> list[Point]:
    """The part of a polygon with x >= NEAREST_M."""
    kept = []
    for p, q in zip(outline, outline[1:] + outline[:1], strict=True):
        if p[0] >= NEAREST_M:
            kept.append(p)
        if (p[0] >= NEAREST_M) != (q[0] >= NEAREST_M):
            t = (NEAREST_M - p[0]) / (q[0] - p[0])
            kept.append((NEAREST_M, p[1] + t * (q[1] - p[1]), p[2] + t * (q[2] - p[2])))
    return kept


def row_bands(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor, windows: Sequence[Window]) -> list[list[Window]]:
    """The window of each primitive of a single scene in a few bands of rows, each as wide as the outline within the band."""
    corners = _corners(primitives, T_world_headlight)
    return [_bands_of(outline, window, grid) for outline, window in zip(corners, windows, strict=True)]


def _bands_of(corners: list[list[float]], window: Window, grid: TexelGrid) -> list[Window]:
    if window.empty:
        return []
    if min(x for x, _, _ in corners) < NEAREST_M:
        return [window]
    a, b, c, d = (
        ((grid.top - z / x) / (grid.top - grid.bottom) * grid.rows - 0.5, (grid.left - y / x) / (grid.left - grid.right) * grid.cols - 0.5)
        for x, y, z in corners
    )  # row and column, whole at texels' centres
    edges, found = ((a, b), (b, d), (d, c), (c, a)), []
    height = -(-(window.v_stop - window.v_start) // BANDS)
    for top in range(window.v_start, window.v_stop, height):
        bottom = min(top + height, window.v_stop)
        across = [at for edge in edges for at in _columns(*edge, top - BANDS_SLACK, bottom - 1 + BANDS_SLACK)]
        if across:
            left, right = (
                max(math.ceil(min(across) - BANDS_SLACK), window.u_start),
                min(math.floor(max(across) + BANDS_SLACK) + 1, window.u_stop),
            )
            if left < right:
                found.append(Window(top, bottom, left, right))
    return found


def _columns(p: tuple[float, float], q: tuple[float, float], top: float, bottom: float) -> list[float]:
    """Columns at both ends of the part of an edge between two rows."""
    (r0, c0), (r1, c1) = sorted((p, q))
    if r1 < top or r0 > bottom:
        return []
    if r1 == r0:
        return [c0, c1]
    slope = (c1 - c0) / (r1 - r0)
    return [c0 + slope * (min(max(r, top), bottom) - r0) for r in (r0, r1)]
