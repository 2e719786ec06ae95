"""Headlight matrices of any overlap: the lamps of the thesis' tables A.1, A.2 and B.1 to B.4."""

import math

import numpy as np
import scipy.sparse as sp

from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid

OVERLAP = 0.25  # of a pixel's pitch, between neighbours


def adaptive_side(cols: int) -> int:
    """Texels along a side, T A.3's rule for `cols` columns of pixels."""
    return 64 * math.ceil(2.2 * cols / 64)


def thesis_lamp(rows: int, cols: int, side: int) -> Headlight:
    """+-4 x +-8 deg in a square texture of +-8.1 deg."""
    return overlapping(rows, cols, TexelGrid.from_degrees(side, side, 8.1, -8.1, -8.1, 8.1), (4.0, 8.0))


def wide_lamp(rows: int, cols: int, texel_rows: int, texel_cols: int) -> Headlight:
    """+-5 x +-10 deg, all of the texture lit."""
    return overlapping(rows, cols, TexelGrid.from_degrees(texel_rows, texel_cols, 10.0, -10.0, -5.0, 5.0), (5.0, 10.0))


def long_rows(rows: int, cols: int, texel_rows: int, texel_cols: int, entries: int) -> Headlight:
    """+-5 x +-20 deg, all of the texture lit, each texel by as many pixels."""
    return overlapping(rows, cols, TexelGrid.from_degrees(texel_rows, texel_cols, 20.0, -20.0, -5.0, 5.0), (5.0, 20.0), math.sqrt(entries))


def disjoint(cols: int, texel_rows: int) -> Headlight:
    """Pixels of aspect 4:1 in number that do not overlap and fill their texture, as for T fig. 6.1."""
    grid = TexelGrid(rows=texel_rows, cols=4 * texel_rows, left=1.0, right=-1.0, bottom=-0.25, top=0.25)
    return _lamp(grid, *((np.arange(m) * n // m)[:, None] == np.arange(n) for m, n in ((grid.rows, cols // 4), (grid.cols, cols))))


def overlapping(rows: int, cols: int, grid: TexelGrid, half_deg: tuple[float, float], reach: float = 1 + OVERLAP) -> Headlight:
    """Pixels of equal angles; each lights the texels whose centres lie within `reach` times its pitch. half_deg: vertical, horizontal."""
    y, z = (np.degrees(np.arctan(each.numpy())) for each in grid.tangents())
    axes = zip((z, y), (rows, cols), half_deg, strict=True)
    return _lamp(grid, *(np.abs((half - angle[:, None]) / (2 * half) * n - 0.5 - np.arange(n)) <= reach / 2 for angle, n, half in axes))


def _lamp(grid: TexelGrid, vertical: np.ndarray, horizontal: np.ndarray) -> Headlight:
    """Of pixels of 1000 cd. vertical, horizontal: which rows and columns of pixels light those of texels, `[texels, pixels]` bool."""
    matrix = Csr.from_scipy(sp.kron(*(sp.csr_matrix(each, dtype=float) for each in (1000 * vertical, horizontal)), "csr"))
    rows, cols = vertical.shape[1], horizontal.shape[1]
    return Headlight(name=f"{rows} x {cols}", matrix=matrix, pixel_rows=rows, pixel_cols=cols, **vars(grid))
