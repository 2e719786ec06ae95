"""A road all around a vehicle that somebody drives: square patches, fine near it and coarse far away, made when they come into sight."""

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
from luxloop.world.roads.base import Floats, Road
from luxloop.world.roads.mesh import grid_mesh
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.triangles import Placed

SIDE_M: Final = 12.0  # of a patch
SIGHT_M: Final = 90.0
BESIDE_M: Final = 40.0  # to both sides of where the vehicle heads
NEAR_M: Final = 24.0  # up to which patches are fine
SPACING_M: Final = (0.2, 1.2)  # of rows and columns, near and far
SKIRT_M: Final = 0.1  # by which the border goes down, so that nobody sees through between fine patches and coarse ones
KEPT: Final = 400  # patches, four times those in sight


@dataclass(frozen=True, eq=False)
class RoadPatches:
    """A road meshed wherever the vehicle is. albedo, texture: as those of a `Body`. sight_m: how far ahead it is there."""

    road: Road
    albedo: float
    texture: Texture | SpottedTexture | None
    name: str = "road"
    track: PoseTrack = field(default_factory=PoseTrack.static)
    sight_m: float = SIGHT_M

    @cached_property
    def _patch(self) -> Callable[[int, int, int, bool], Placed]:
        """`_make`, memoised for the last patches."""
        return keeping(KEPT, self._make)

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Placed, ...]:
        """The patches in sight of a vehicle at `T_world_ground` `[4, 4]`, as parts of the body `object_id`."""
        (cos, sin), place = T_world_ground[:2, 0].tolist(), T_world_ground[:2, 3].numpy()
        reach = math.ceil((self.sight_m + SIDE_M) / SIDE_M)
        i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1) + np.floor(place / SIDE_M).astype(int)[:, None]
        x, y = (SIDE_M * (np.stack([i, j]) + 0.5)) - place[:, None]
        ahead, left, half = cos * x + sin * y, cos * y - sin * x, SIDE_M * math.sqrt(0.5)
        seen = (ahead > -half) & (ahead < self.sight_m + half) & (abs(left) < BESIDE_M + half)
        far = np.hypot(np.clip(abs(x) - SIDE_M / 2, 0, None), np.clip(abs(y) - SIDE_M / 2, 0, None)) > NEAR_M
        return tuple(self._patch(object_id, *each) for each in zip(i[seen].tolist(), j[seen].tolist(), far[seen].tolist(), strict=True))

    def _make(self, object_id: int, i: int, j: int, far: bool) -> Placed:
        """Normals look one row beyond the patch."""
        grid, spacing = self.road.grid(), SPACING_M[far]
        x, y = _lines(i * SIDE_M, spacing, grid.x_lines_m), _lines(j * SIDE_M, spacing, grid.y_lines_m)
        around_x, around_y = (np.concatenate([[each[0] - spacing], each, [each[-1] + spacing]]) for each in (x, y))
        z = self.road.z(around_x[:, None], around_y)
        height_and_slopes = np.stack([z, *np.gradient(z, around_x, around_y)])[:, 1:-1, 1:-1]
        grids = (*np.meshgrid(x, y, indexing="ij"), *height_and_slopes)
        X, Y, Z, dx, dy = (np.pad(each, 1, mode="edge") for each in grids)
        Z = Z - np.pad(np.zeros((len(x), len(y))), 1, constant_values=SKIRT_M)
        mesh = grid_mesh(X, Y, Z, np.stack([-dx, -dy, np.ones_like(dx)], axis=-1))
        return Placed(object_id, Body(self.name, mesh, self.albedo, self.texture, smooth=True), torch.eye(4, dtype=torch.float64))


def _lines(start: float, spacing: float, required: tuple[float, ...]) -> Floats:
    """Of a patch that starts there in m; those that the road asks for are among them."""
    regular = np.linspace(start, start + SIDE_M, round(SIDE_M / spacing) + 1)
    return np.unique(np.concatenate([regular, [line for line in required if start < line < start + SIDE_M]]))
