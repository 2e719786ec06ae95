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
    return overlapping(rows, cols, TexelGrid.from_degrees(side, side, 8.1, -8.1, -8.1, 8.1), (4.0, 8.0), 1 + OVERLAP)


def wide_lamp(rows: int, cols: int, texel_rows: int, texel_cols: int) -> Headlight:
    """+-5 x +-10 deg, all of the texture lit."""
    return overlapping(rows, cols, TexelGrid.from_degrees(texel_rows, texel_cols, 10.0, -10.0, -5.0, 5.0), (5.0, 10.0), 1 + OVERLAP)


def long_rows(rows: int, cols: int, texel_rows: int, texel_cols: int, entries: int) -> Headlight:
    """+-5 x +-20 deg, all of the texture lit, each texel by as many pixels."""
    return overlapping(rows, cols, TexelGrid.from_degrees(texel_rows, texel_cols, 20.0, -20.0, -5.0, 5.0), (5.0, 20.0), math.sqrt(entries))


def disjoint(cols: int, texel_rows: int) -> Headlight:
    """Pixels of aspect 4:1 in number that do not overlap and fill their texture, as for T fig. 6.1."""
    grid = TexelGrid(rows=texel_rows, cols=4 * texel_rows, left=1.0, right=-1.0, bottom=-0.25, top=0.25)
    row, col = np.arange(grid.rows) * (cols // 4) // grid.rows, np.arange(grid.cols) * cols // grid.cols
    n = grid.rows * grid.cols
    pixel = (row[:, None] * cols + col).ravel()
    return _lamp(cols // 4, cols, grid, sp.csr_matrix((np.full(n, 1000.0), pixel, np.arange(n + 1)), shape=(n, cols // 4 * cols)))


def overlapping(rows: int, cols: int, grid: TexelGrid, half_deg: tuple[float, float], reach: float) -> Headlight:
    """Pixels of equal angles; each lights the texels whose centres lie within `reach` times its pitch. half_deg: vertical, horizontal."""
    z = np.degrees(np.arctan(grid.top + (np.arange(grid.rows) + 0.5) / grid.rows * (grid.bottom - grid.top)))
    y = np.degrees(np.arctan(grid.left + (np.arange(grid.cols) + 0.5) / grid.cols * (grid.right - grid.left)))
    vertical, horizontal = (_axis(*each, reach) for each in ((z, rows, half_deg[0]), (y, cols, half_deg[1])))
    return _lamp(rows, cols, grid, sp.kron(vertical, horizontal, "csr"))


def _lamp(rows: int, cols: int, grid: TexelGrid, matrix: sp.csr_matrix) -> Headlight:
    return Headlight(name=f"{rows} x {cols}", matrix=Csr.from_scipy(matrix), pixel_rows=rows, pixel_cols=cols, **vars(grid))


def _axis(angle_deg: np.ndarray, n: int, half_deg: float, reach: float) -> sp.csr_matrix:
    """Which of n pixels from half_deg down to -half_deg light which angles."""
    position = (half_deg - angle_deg) / (2 * half_deg) * n - 0.5  # in pixels
    pixel = np.round(position).astype(int)[:, None] + np.arange(-math.ceil(reach), math.ceil(reach) + 1)
    lit = (pixel >= 0) & (pixel < n) & (np.abs(position[:, None] - pixel) <= reach / 2)
    texel = np.broadcast_to(np.arange(len(angle_deg))[:, None], pixel.shape)
    return sp.csr_matrix((np.full(lit.sum(), math.sqrt(1000.0)), (texel[lit], pixel[lit])), shape=(len(angle_deg), n))
