"""From a distribution on the sphere to a light texture of any grid (T 5.2).

A texel that spans more than half a step of the file's angles holds the average over its solid angle, so that the flux is kept; a finer
one is interpolated. Which of the two is decided texel by texel, since the steps of a file and the angles of texels both vary.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from world.photometry.distribution import Aim, Array, Distribution, angles_of
from world.texels import TexelGrid, bilinear

FINE_STEPS = 0.5  # up to so much of a step, a texel is interpolated: its share of a kink hardly counts
SAMPLES_PER_STEP = 4  # in each direction: the file is bilinear within a step
MOST_SAMPLES = 256  # a side of a texel; more than that no average needs, and at the pole of type C the azimuth turns without end
EDGE_STEPS = 4  # the end of a table, where light may stop at once, counts as so many steps
_CHUNK = 1 << 20  # samples in memory at a time
_PROBES = 1 << 16


def light_texture(distribution: Distribution, grid: TexelGrid, aim: Aim = "beam") -> Array:
    """Luminous intensity `[rows, cols]` in cd of each texel (T 5.2); aim as in Distribution.intensity."""
    texture = np.empty((grid.rows, grid.cols))
    across, down = samples(distribution, grid, aim)
    both = across * (MOST_SAMPLES + 1) + down
    for n in np.unique(both):
        n_y, n_z = divmod(int(n), MOST_SAMPLES + 1)
        rows, cols = np.nonzero(both == n)
        step = max(_CHUNK // (n_y * n_z), 1)
        for start in range(0, len(rows), step):
            r, c = rows[start : start + step], cols[start : start + step]
            y, z = _plane(grid, r[:, None, None] + _centres(n_z)[:, None], c[:, None, None] + _centres(n_y))
            light = distribution.intensity(_directions(y, z), aim)
            weight = (1 + y**2 + z**2) ** -1.5  # solid angle of equal areas of the plane
            texture[r, c] = (light * weight).sum((1, 2)) / weight.sum((1, 2))
    return texture


def samples(distribution: Distribution, grid: TexelGrid, aim: Aim = "beam") -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many samples across and down average each texel, `[rows, cols]` twice, powers of two; 1 where it is interpolated."""
    row, col = np.arange(grid.rows)[:, None] + 0.5, np.arange(grid.cols) + 0.5
    half_rows, half_cols = np.arange(2 * grid.rows + 1)[:, None] / 2, np.arange(2 * grid.cols + 1) / 2
    counts = []
    for axis, (v, h) in ((1, _steps(distribution, grid, row, half_cols, aim)), (0, _steps(distribution, grid, half_rows, col, aim))):
        # By halves, since the pole of type C may lie in the middle, with the same angle on both sides.
        crossed = np.maximum(np.abs(np.diff(v, axis=axis)), _turned(np.diff(h, axis=axis), distribution))
        crossed = np.add.reduceat(crossed, np.arange(0, crossed.shape[axis], 2), axis=axis)
        finer = np.exp2(np.ceil(np.log2(np.maximum(SAMPLES_PER_STEP * crossed, 1)))).astype(np.int64)
        counts.append(np.where(crossed <= FINE_STEPS, 1, np.minimum(finer, MOST_SAMPLES)))
    across, down = counts
    # The table's lines may run aslant: what is averaged one way is not constant the other.
    averaged = (across > 1) | (down > 1)
    return np.where(averaged, np.maximum(across, SAMPLES_PER_STEP), 1), np.where(averaged, np.maximum(down, SAMPLES_PER_STEP), 1)


def solid_angles(grid: TexelGrid) -> Array:
    """Solid angle `[rows, cols]` in sr of each texel."""
    y, z = _plane(grid, np.arange(grid.rows + 1.0)[:, None], np.arange(grid.cols + 1.0))
    corner = np.arctan2(y * z, np.sqrt(1 + y**2 + z**2))
    return np.diff(np.diff(corner, axis=0), axis=1)


def rmse(distribution: Distribution, grid: TexelGrid, texture: Array, aim: Aim = "beam") -> float:
    """Root mean square difference in cd between a texture, as it is looked up, and its source.

    Over the solid angle within the texture's borders, at 65 536 evenly spread directions that favour no texel and no angle of the file.
    """
    # Additive recurrence with the reciprocals of the plastic number: as even as a grid, without its rows.
    row, col = (np.arange(_PROBES) * share % 1.0 * n for share, n in ((0.7548776662466927, grid.rows), (0.5698402909980532, grid.cols)))
    y, z = _plane(grid, row, col)
    weight = (1 + y**2 + z**2) ** -1.5
    texel, share = bilinear(grid, torch.from_numpy(row), torch.from_numpy(col))
    looked_up = (texture.ravel()[texel.numpy()] * share.numpy()).sum(0)
    difference = looked_up - distribution.intensity(_directions(y, z), aim)
    return float(np.sqrt((weight * difference**2).sum() / weight.sum()))


def _plane(grid: TexelGrid, row: NDArray, col: NDArray) -> tuple[Array, Array]:
    """Tangents y and z of continuous texture coordinates, broadcast against each other."""
    y = grid.left + np.asarray(col, np.float64) / grid.cols * (grid.right - grid.left)
    z = grid.top + np.asarray(row, np.float64) / grid.rows * (grid.bottom - grid.top)
    y, z = np.broadcast_arrays(y, z)
    return y, z


def _directions(y: Array, z: Array) -> Array:
    return np.stack([np.ones_like(y), y, z])


def _centres(n: int) -> Array:
    return (np.arange(n) + 0.5) / n


def _steps(distribution: Distribution, grid: TexelGrid, row: NDArray, col: NDArray, aim: Aim) -> tuple[Array, Array]:
    """Where texture coordinates lie in the table, counted in its steps: vertical, horizontal."""
    v, h, _ = distribution.unfolded
    v_at, h_at = angles_of(distribution.type, _directions(*_plane(grid, row, col)), aim)
    if distribution.type == "C":
        h_at = h[0] + np.mod(h_at - h[0], 360.0)
    return _counted(v_at, v), _counted(h_at, h)


def _counted(x: Array, nodes: Array) -> Array:
    n = len(nodes)
    return np.interp(x, nodes, np.arange(n), left=-EDGE_STEPS, right=n - 1 + EDGE_STEPS)


def _turned(steps: Array, distribution: Distribution) -> Array:
    """Horizontal steps crossed, the short way round where a distribution goes round."""
    steps = np.abs(steps)
    if distribution.type == "C" and distribution.complete:
        turn = len(distribution.unfolded[1]) - 1
        return np.minimum(steps, turn - steps)
    return steps
