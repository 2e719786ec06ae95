"""The lamps of the thesis' tables A.1 and A.2, and others of any overlap, as headlight matrices."""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from luxloop.world.texels import TexelGrid

SIZES = ((45, 90), (125, 250), (390, 780), (670, 1340), (870, 1740))  # rows x columns of pixels
THESIS_FIXED_US = (429.7, 432.9, 480.3, 454.9, 454.9)  # medians of table A.1, Nvidia 2080 Ti
THESIS_ADAPTIVE_US = (98.7, 135.1, 397.8, 845.9, 1646.3)  # of table A.2
FIXED_SIDE = 2048
OVERLAP = 0.25  # of a pixel's pitch, between neighbours


@dataclass(frozen=True)
class Lamp:
    """rows x cols pixels over a light texture; matrix `[n_t, n_p]` float32 in cd, int32 indices."""

    name: str
    rows: int
    cols: int
    grid: TexelGrid
    matrix: sp.csr_matrix
    thesis_us: float | None = None


def adaptive_side(cols: int) -> int:
    """Texels along a side, T A.3's rule for `cols` columns of pixels."""
    return 64 * math.ceil(2.2 * cols / 64)


def of_the_thesis(rows: int, cols: int, side: int, thesis_us: float | None = None) -> Lamp:
    """+-4 x +-8 deg in a square texture of +-8.1 deg."""
    grid = TexelGrid.from_degrees(side, side, 8.1, -8.1, -8.1, 8.1)
    return replace(overlapping(f"{rows} x {cols}", rows, cols, grid, 4.0, 8.0, 1 + OVERLAP), thesis_us=thesis_us)


def with_long_rows(rows: int, cols: int, texel_rows: int, texel_cols: int, entries: int) -> Lamp:
    """+-5 x +-20 deg, all of the texture lit, each texel by as many pixels."""
    grid = TexelGrid.from_degrees(texel_rows, texel_cols, 20.0, -20.0, -5.0, 5.0)
    return overlapping(f"{rows} x {cols}, {entries} entries", rows, cols, grid, 5.0, 20.0, math.sqrt(entries))


def disjoint(cols: int, texel_rows: int) -> Lamp:
    """Pixels of aspect 4:1 in number that do not overlap and fill their texture, as for T fig. 6.1."""
    rows = cols // 4
    grid = TexelGrid(rows=texel_rows, cols=4 * texel_rows, left=1.0, right=-1.0, bottom=-0.25, top=0.25)
    row = np.arange(texel_rows) * rows // texel_rows
    col = np.arange(4 * texel_rows) * cols // (4 * texel_rows)
    indices = (row[:, None] * cols + col).ravel().astype(np.int32)
    arrays = (np.full(len(indices), 1000.0, np.float32), indices, np.arange(len(indices) + 1, dtype=np.int32))
    return Lamp(f"{rows} x {cols}", rows, cols, grid, sp.csr_matrix(arrays, shape=(len(indices), rows * cols)))


def overlapping(name: str, rows: int, cols: int, grid: TexelGrid, half_height_deg: float, half_width_deg: float, reach: float) -> Lamp:
    """Pixels of equal angles; each lights the texels whose centres lie within `reach` times its pitch."""
    z = np.degrees(np.arctan(grid.top + (np.arange(grid.rows) + 0.5) / grid.rows * (grid.bottom - grid.top)))
    y = np.degrees(np.arctan(grid.left + (np.arange(grid.cols) + 0.5) / grid.cols * (grid.right - grid.left)))
    vertical, horizontal = _axis(z, rows, half_height_deg, reach), _axis(y, cols, half_width_deg, reach)
    matrix = sp.csr_matrix(sp.kron(vertical, horizontal, "csr"))
    matrix.sort_indices()
    arrays = (matrix.data.astype(np.float32), matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32))
    return Lamp(name, rows, cols, grid, sp.csr_matrix(arrays, shape=matrix.shape))


def _axis(angle_deg: np.ndarray, n: int, half_deg: float, reach: float) -> sp.csr_matrix:
    """Which of n pixels from half_deg down to -half_deg light which angles."""
    position = (half_deg - angle_deg) / (2 * half_deg) * n - 0.5  # in pixels
    pixel = np.round(position).astype(int)[:, None] + np.arange(-math.ceil(reach), math.ceil(reach) + 1)
    lit = (pixel >= 0) & (pixel < n) & (np.abs(position[:, None] - pixel) <= reach / 2)
    texel = np.broadcast_to(np.arange(len(angle_deg))[:, None], pixel.shape)
    return sp.csr_matrix((np.full(lit.sum(), math.sqrt(1000.0)), (texel[lit], pixel[lit])), shape=(len(angle_deg), n))
