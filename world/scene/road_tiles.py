"""A road along a drive: tiles across it, fine near the vehicle and coarse far ahead, made when they come into sight."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import torch
from torch import Tensor

from luxloop.world.kept import keeping
from luxloop.world.materials.library import Texture
from luxloop.world.materials.spots import SpottedTexture
from luxloop.world.roads.base import Road
from luxloop.world.roads.mesh import axis, grid_mesh
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.triangles import Placed

LENGTH_M: Final = 6.0  # of a tile
SIGHT_M: Final = 90.0
NEAR_M: Final = 30.0  # where light falls that shall be judged
ALONG_M: Final = (0.1, 0.6)  # spacing of rows, near and far: in a camera at 1.35 m a pixel is 0.2 m long at 17 m, 1 m at 40 m
ACROSS_M: Final = 0.12
BESIDE_M: Final = (3.5, 25.0)  # to both sides of the course: finely meshed, and meshed at all
AROUND_M: Final = 5.0  # objects, beyond their middle
KEPT: Final = 4  # times the tiles that are in sight


@dataclass(frozen=True, eq=False)
class RoadTiles:
    """A road meshed where the vehicle comes.

    course_y_m: least and greatest y of its course. albedo, texture: as those of a `Body`. others_y_m: y of what else shall stand on it.
    sight_m: how far ahead it is there.
    """

    road: Road
    course_y_m: tuple[float, float]
    albedo: float
    texture: Texture | SpottedTexture | None
    name: str = "road"
    track: PoseTrack = field(default_factory=PoseTrack.static)
    others_y_m: tuple[float, ...] = ()
    sight_m: float = SIGHT_M

    @cached_property
    def _edges_m(self) -> tuple[float, float]:
        """Least and greatest y of the mesh."""
        (low, high), wide = self.course_y_m, BESIDE_M[1]
        others_y_m = [y + side for y in self.others_y_m for side in (-AROUND_M, AROUND_M)]
        return min((low - wide, *others_y_m)), max((high + wide, *others_y_m))

    @cached_property
    def _tile(self) -> Callable[[int, int, bool], Placed]:
        """`_make`, memoised for the last tiles."""
        return keeping(KEPT * math.ceil(self.sight_m / LENGTH_M), self._make)

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Placed, ...]:
        """The tiles in sight of a vehicle at `T_world_ground` `[4, 4]`, as parts of the body `object_id`."""
        (cos, sin), (x, y) = T_world_ground[:2, 0].tolist(), T_world_ground[:2, 3].tolist()
        tiles = []
        for k in range(int((x - self.sight_m) // LENGTH_M), int((x + self.sight_m) // LENGTH_M) + 1):
            start, stop = k * LENGTH_M, (k + 1) * LENGTH_M
            if max((end - x) * cos + (side - y) * sin for end in (start, stop) for side in self._edges_m) > 0:
                far = max(start - x, x - stop) > NEAR_M
                tiles.append(self._tile(object_id, k, far))
        return tuple(tiles)

    def _make(self, object_id: int, k: int, far: bool) -> Placed:
        """Rows share their columns at all distances, so that tiles meet without gaps; normals look one row beyond the tile."""
        start, grid = k * LENGTH_M, self.road.grid()
        rows = round(LENGTH_M / ALONG_M[far])
        x = np.linspace(start, start + LENGTH_M, rows + 1)
        x = np.unique(np.concatenate([x, [line for line in grid.x_lines_m if start < line < start + LENGTH_M]]))
        (low, high), fine = self.course_y_m, BESIDE_M[0]
        y = axis(self._edges_m, (low - fine, high + fine), ACROSS_M, grid.y_lines_m)
        margin = ALONG_M[0]
        around = np.concatenate([[x[0] - margin], x, [x[-1] + margin]])
        z = self.road.z(around[:, None], y)
        dx, dy = np.gradient(z, around, y)
        normals = np.stack([-dx, -dy, np.ones_like(z)], axis=-1)
        mesh = grid_mesh(*np.meshgrid(x, y, indexing="ij"), z[1:-1], normals[1:-1])
        return Placed(object_id, Body(self.name, mesh, self.albedo, self.texture, smooth=True), torch.eye(4, dtype=torch.float64))
