"""Triangles of a road: a tensor-product grid, fine where the light falls and growing coarser around."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxloop.world.roads.base import Floats, Road
from luxloop.world.roads.own import OwnRoad
from luxloop.world.roads.scan import OpenCrgRoad

if TYPE_CHECKING:
    import trimesh

SCENE_X_M = (-6.0, 120.0)
SCENE_Y_M = (-25.0, 25.0)
GROWTH = 1.15  # of the spacing from one row to the next outside the fine part


def refuse_broken(road: Road) -> None:
    """Look at a road of a file or of one's own where its mesh will end. Raises LuxloopError where it has no heights there."""
    if isinstance(road, OpenCrgRoad | OwnRoad):
        road.grid()
        road.z(np.array(SCENE_X_M)[:, None], np.array(SCENE_Y_M))


def road_mesh(road: Road) -> "trimesh.Trimesh":
    """Mesh of a road in the vehicle frame: vertices in m (float64) on the surface, counter-clockwise seen from above, so normals point up.

    Between 150,000 and 400,000 faces over x = -6 to 120 m, y = -25 to 25 m; a flat road needs fewer than 10,000.
    """
    grid = road.grid()
    x = axis(SCENE_X_M, grid.x_m, grid.spacing_m[0], grid.x_lines_m)
    y = axis(SCENE_Y_M, grid.y_m, grid.spacing_m[1], grid.y_lines_m)
    X, Y = np.meshgrid(x, y, indexing="ij")
    return grid_mesh(X, Y, road.z(X, Y))


def grid_mesh(x: Floats, y: Floats, z: Floats, normals: Floats | None = None) -> "trimesh.Trimesh":
    """Mesh of a grid of vertices `[n_x, n_y]` m. normals: their directions `[n_x, n_y, 3]`, None for those of the faces."""
    import trimesh  # which takes a seventh of a command's start, and only what is looked at needs it

    if normals is not None:
        normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).reshape(-1, 3)
    return trimesh.Trimesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), _grid_faces(*x.shape), vertex_normals=normals, process=False)


def _grid_faces(n_x: int, n_y: int) -> NDArray[np.int64]:
    """Corners `[F, 3]` of the triangles between `n_x` rows of `n_y` vertices, counter-clockwise seen from above."""
    corner = (np.arange(n_x - 1)[:, None] * n_y + np.arange(n_y - 1)).ravel()
    ahead, left = corner + n_y, corner + 1
    return np.stack([corner, ahead, ahead + 1, corner, ahead + 1, left], axis=-1).reshape(-1, 3)


def axis(scene: tuple[float, float], fine: tuple[float, float], spacing: float, lines: tuple[float, ...]) -> Floats:
    """Ascending grid lines in m from one end of the scene to the other, evenly spaced in the fine part; `lines` are among them."""
    middle = np.linspace(*fine, round((fine[1] - fine[0]) / spacing) + 1)
    below = fine[0] - _growing(fine[0] - scene[0], spacing)[::-1]
    above = fine[1] + _growing(scene[1] - fine[1], spacing)
    regular = np.concatenate([below, middle, above])
    required = np.array(lines, np.float64)
    if not len(required):
        return regular
    # Lines that the road asks for replace regular ones right beside them, which would make slivers.
    beside = np.abs(regular[:, None] - required).min(axis=1) < 0.2 * spacing
    beside[[0, -1]] = False
    return np.unique(np.concatenate([regular[~beside], required]))


def _growing(length: float, spacing: float) -> Floats:
    """Distances from the fine part outwards up to `length`, the first a little over `spacing`."""
    count = max(1, round(np.log1p(length * (GROWTH - 1) / (spacing * GROWTH)) / np.log(GROWTH)))
    steps = np.cumsum(GROWTH ** np.arange(1, count + 1))
    return np.asarray(length * steps / steps[-1], np.float64)
