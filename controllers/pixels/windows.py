"""The windows of a light texture that primitives can touch: bounding rectangles of their projected outlines.

They are tighter than the ellipsoids around groups in T 7.3.3, and cull all rays of a primitive at once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives
from luxloop.world.texels import TexelGrid

NEAREST_M = 1e-3  # distance ahead of the photometric centre at which primitives that reach behind the lamp are clipped
SLACK = 0.01  # texels, margin for rounding
BANDS = 4  # of rows, narrower than the window of a slanting outline
BANDS_SLACK = 0.05  # texels, margin for rounding
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Window:
    """A rectangle of texels in the light texture; stops are exclusive."""

    row_start: int
    row_stop: int
    col_start: int
    col_stop: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices of a light texture."""
        return slice(self.row_start, self.row_stop), slice(self.col_start, self.col_stop)

    @property
    def texels(self) -> int:
        """Number of its texels, if it is not empty."""
        return (self.row_stop - self.row_start) * (self.col_stop - self.col_start)

    @property
    def empty(self) -> bool:
        return self.row_stop <= self.row_start or self.col_stop <= self.col_start

    def meets(self, other: "Window") -> bool:
        """Whether both windows share a texel."""
        rows = self.row_start < other.row_stop and other.row_start < self.row_stop
        return rows and self.col_start < other.col_stop and other.col_start < self.col_stop

    def holds(self, other: "Window") -> bool:
        """Whether another window lies within this one."""
        rows = self.row_start <= other.row_start and other.row_stop <= self.row_stop
        return rows and self.col_start <= other.col_start and other.col_stop <= self.col_stop

    def widen(self, texels: int, grid: TexelGrid) -> "Window":
        """The window with a margin in texels on all sides, clipped to the light texture."""
        rows = max(self.row_start - texels, 0), min(self.row_stop + texels, grid.rows)
        return Window(*rows, max(self.col_start - texels, 0), min(self.col_stop + texels, grid.cols))

    def within(self, outer: "Window") -> tuple[slice, slice]:
        """Row and column slices of this window in an image on an outer window."""
        rows = slice(self.row_start - outer.row_start, self.row_stop - outer.row_start)
        return rows, slice(self.col_start - outer.col_start, self.col_stop - outer.col_start)


NOWHERE = Window(0, 0, 0, 0)


def whole(grid: TexelGrid) -> Window:
    """The whole light texture as a window."""
    return Window(0, grid.rows, 0, grid.cols)


def union(windows: list[Window]) -> Window:
    """The smallest window around all non-empty windows."""
    lit = [w for w in windows if not w.empty]
    if not lit:
        return NOWHERE
    return reduce(
        lambda a, b: Window(
            min(a.row_start, b.row_start), max(a.row_stop, b.row_stop), min(a.col_start, b.col_start), max(a.col_stop, b.col_stop)
        ),
        lit,
    )


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
    """Texels whose centres lie between, or at most a texel beyond."""
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
    """The window of each primitive of a single scene in a few bands of rows, each as wide as its outline there."""
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
    height = -(-(window.row_stop - window.row_start) // BANDS)
    for top in range(window.row_start, window.row_stop, height):
        bottom = min(top + height, window.row_stop)
        across = [at for edge in edges for at in _columns(*edge, top - BANDS_SLACK, bottom - 1 + BANDS_SLACK)]
        if across:
            left, right = (
                max(math.ceil(min(across) - BANDS_SLACK), window.col_start),
                min(math.floor(max(across) + BANDS_SLACK) + 1, window.col_stop),
            )
            if left < right:
                found.append(Window(top, bottom, left, right))
    return found


def _columns(p: tuple[float, float], q: tuple[float, float], top: float, bottom: float) -> list[float]:
    """Columns of the two ends of an edge's part between two rows."""
    (r0, c0), (r1, c1) = sorted((p, q))
    if r1 < top or r0 > bottom:
        return []
    if r1 == r0:
        return [c0, c1]
    slope = (c1 - c0) / (r1 - r0)
    return [c0 + slope * (min(max(r, top), bottom) - r0) for r in (r0, r1)]
