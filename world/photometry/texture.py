"""From a distribution on the sphere to a light texture of any grid (T 5.2).

A texel that spans more than half a step of the file's angles holds the average over its solid angle, so that the flux is kept; a finer
one is interpolated. Which of the two is decided texel by texel, since the steps of a file and the angles of texels both vary.
"""

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from luxloop.world.photometry.distribution import EDGE_DEG, Aim, Array, Distribution, angles_of, directions_of
from luxloop.world.texels import TexelGrid, bilinear

FINE_STEPS = 0.52  # of a step: a texel up to this size is interpolated; half a step, and a margin for oblique texels
SAMPLES_PER_STEP = 4  # in each direction: the file is bilinear within a step
MOST_SAMPLES = 256  # a side of a texel; at the pole of type C the azimuth would ask for any number
EDGE_STEPS = 4  # an edge, where light stops at once, counts as this many steps
PROBES = 1 << 16  # directions in which a texture is compared with its source
_CHUNK = 1 << 20  # samples in memory at a time

Window = tuple[NDArray[np.intp], NDArray[np.intp]]  # consecutive rows and columns of texels


def light_texture(
    distribution: Distribution, grid: TexelGrid, aim: Aim = "beam", turn: Array | None = None, window: Window | None = None
) -> Array:
    """Luminous intensity `[rows, cols]` in cd of each texel, or of those in a window of the grid (T 5.2).

    aim: as in Distribution.intensity. turn: `[3, 3]`, takes directions of the distribution's frame to the headlight frame.
    """
    rows, cols = window = window or (np.arange(grid.rows), np.arange(grid.cols))
    v, h = angles_about(distribution, grid, aim, turn, window)
    texture = distribution.at(v[1:-1, 1:-1], h[1:-1, 1:-1])
    across, down = samples(distribution, v, h)
    both = across * (MOST_SAMPLES + 1) + down
    for n in np.unique(both[across > 1]):
        n_y, n_z = divmod(int(n), MOST_SAMPLES + 1)
        i, j = np.nonzero(both == n)
        step = max(_CHUNK // (n_y * n_z), 1)
        for start in range(0, len(i), step):
            r, c = i[start : start + step], j[start : start + step]
            y, z = _plane(grid, rows[r, None, None] + _centres(n_z)[:, None], cols[c, None, None] + _centres(n_y))
            light = distribution.intensity(_towards(y, z, turn), aim)
            square = 1 + y**2 + z**2
            weight = 1 / (square * np.sqrt(square))  # solid angle of equal areas of the plane
            texture[r, c] = (light * weight).sum((1, 2)) / weight.sum((1, 2))
    return texture


def angles_about(distribution: Distribution, grid: TexelGrid, aim: Aim, turn: Array | None, window: Window) -> tuple[Array, Array]:
    """Vertical and horizontal angles `[rows + 2, cols + 2]` in deg of the centres of texels and of those all round."""
    row, col = (np.arange(each[0] - 1, each[-1] + 2) + 0.5 for each in window)
    return angles_of(distribution.type, _towards(*_plane(grid, row[:, None], col), turn), aim)


def samples(distribution: Distribution, v_deg: Array, h_deg: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many samples across and down average each texel, `[rows, cols]` twice; 1 where it is interpolated.

    Numbers from 2, 3, 4, 6, 8, 12 and so on, so that many texels are averaged together. v_deg, h_deg: see angles_about.
    """
    v, h, candela = distribution.full_table
    if distribution.type == "C":
        h_deg = h[0] + np.mod(h_deg - h[0], 360.0)
    v_at, h_at = _table_steps(v_deg, v, candela.T), _table_steps(h_deg, h, candela)
    turn = _table_steps(h, h, candela)[-1] if distribution.type == "C" and distribution.complete else np.inf
    counts = []
    for axis in (1, 0):
        dv, dh = np.abs(np.diff(v_at, axis=axis)), np.abs(np.diff(h_at, axis=axis))
        crossed = np.maximum(dv, np.minimum(dh, turn - dh))  # the short way round
        # To the neighbour on the one side or on the other: at the pole of type C both may have the same angle.
        crossed = np.maximum(crossed[:, 1:], crossed[:, :-1])[1:-1] if axis else np.maximum(crossed[1:], crossed[:-1])[:, 1:-1]
        finer = np.ceil(np.exp2(np.ceil(2 * np.log2(np.maximum(SAMPLES_PER_STEP * crossed, 2))) / 2))
        counts.append((np.minimum(finer, MOST_SAMPLES).astype(np.int64), crossed <= FINE_STEPS))
    (across, narrow), (down, low) = counts
    # The table's lines may run aslant: what is averaged one way is not constant the other.
    fine = narrow & low
    return np.where(fine, 1, across), np.where(fine, 1, down)


def solid_angles(grid: TexelGrid) -> Array:
    """Solid angle `[rows, cols]` in sr of each texel."""
    y, z = _plane(grid, np.arange(grid.rows + 1.0)[:, None], np.arange(grid.cols + 1.0))
    corner = np.arctan2(y * z, np.sqrt(1 + y**2 + z**2))
    return np.diff(np.diff(corner, axis=0), axis=1)


def rmse(distribution: Distribution, grid: TexelGrid, texture: Array, aim: Aim = "beam") -> float:
    """Root mean square difference in cd between a texture `[rows, cols]`, as it is looked up, and its source.

    Over the solid angle into which the source shines; light beyond the texture's borders counts as an error.
    """
    squares, solid = squared_error(distribution, grid, texture, aim)
    return float(np.sqrt(squares / max(solid, np.finfo(float).tiny)))


def squared_error(
    distribution: Distribution, grid: TexelGrid, texture: Array, aim: Aim = "beam", turn: Array | None = None, number: int = PROBES
) -> tuple[float, float]:
    """Integral in cd² sr of the squared difference of a texture and its source over the source's solid angle, and that solid angle in sr.

    number: of evenly spread sample directions.
    """
    directions, candela, solid = _probes(distribution, aim, number)
    x, y, z = directions if turn is None else turn @ directions
    ahead = x > 0
    row, col = grid.texel_of(*(torch.from_numpy(each[ahead] / x[ahead]) for each in (y, z)))
    texel, share = bilinear(grid, row, col)
    difference = -candela
    difference[ahead] += (texture.ravel()[texel.numpy()] * share.numpy()).sum(0)
    return float(difference @ difference) * solid, len(candela) * solid


@lru_cache(maxsize=4)
def _probes(distribution: Distribution, aim: Aim, number: int) -> tuple[Array, Array, float]:
    """Directions `[3, N]` into which a distribution shines, its cd there `[N]`, and the solid angle of each in sr."""
    v, h, candela = distribution.full_table
    # Additive recurrence with the reciprocals of the plastic number: as even as a grid, without its rows.
    across, up = (np.arange(number) * share % 1.0 for share in (0.7548776662466927, 0.5698402909980532))
    (v0, v1), (h0, h1) = _lit(v, candela.T), _lit(h, candela)
    if distribution.type == "B":
        low, high = np.sin(np.radians([h0, h1]))
        v_at, h_at = v0 + up * (v1 - v0), np.degrees(np.arcsin(low + across * (high - low)))
        area = np.radians(v1 - v0) * (high - low)
    else:
        pole = 90.0 if distribution.type == "C" else 0.0
        low, high = np.sin(np.radians([v0 - pole, v1 - pole]))
        v_at, h_at = pole + np.degrees(np.arcsin(low + up * (high - low))), h0 + across * (h1 - h0)
        area = np.radians(h1 - h0) * (high - low)
    light = distribution.at(v_at, h_at)
    shines = light > 0
    return directions_of(distribution.type, v_at[shines], h_at[shines], aim), light[shines], float(area) / number


def _lit(nodes: Array, light: Array) -> tuple[float, float]:
    """The angles between which there is light; light: `[nodes, ...]`."""
    lit = np.flatnonzero(light.any(1))
    return (nodes[max(lit[0] - 1, 0)], nodes[min(lit[-1] + 1, len(nodes) - 1)]) if len(lit) else (nodes[0], nodes[-1])


def _plane(grid: TexelGrid, row: NDArray, col: NDArray) -> tuple[Array, Array]:
    """Tangents y and z of continuous texture coordinates, broadcast against each other."""
    y = grid.left + np.asarray(col, np.float64) / grid.cols * (grid.right - grid.left)
    z = grid.top + np.asarray(row, np.float64) / grid.rows * (grid.bottom - grid.top)
    y, z = np.broadcast_arrays(y, z)
    return y, z


def _towards(y: Array, z: Array, turn: Array | None) -> Array:
    """Directions `[3, ...]` of the distribution's frame through points of the texture's plane."""
    directions = np.stack([np.ones_like(y), y, z])
    return directions if turn is None else np.tensordot(turn.T, directions, 1)


def _centres(n: int) -> Array:
    return (np.arange(n) + 0.5) / n


def _table_steps(x: Array, nodes: Array, light: Array) -> Array:
    """Positions of angles in the table, in steps; edges, where light stops at once, count as EDGE_STEPS. light: `[nodes, ...]`."""
    count = np.append(0.0, np.cumsum(np.where(np.diff(nodes) <= EDGE_DEG, EDGE_STEPS, 1)))
    before, behind = (EDGE_STEPS if each.any() else 0 for each in (light[0], light[-1]))
    return np.interp(x, nodes, count, left=-before, right=count[-1] + behind)
