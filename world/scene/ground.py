"""The road as bodies, meshed on demand: as a whole, in tiles along a given course, in patches around a vehicle under manual control."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.world.caches import keeping
from luxloop.world.materials.library import SpottedTexture, Texture
from luxloop.world.roads.base import Floats, Road
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.roads.shapes import OwnRoad
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.triangles import Instance

if TYPE_CHECKING:
    import trimesh

SCENE_X_M = (-6.0, 120.0)
SCENE_Y_M = (-25.0, 25.0)
GROWTH = 1.15  # of the spacing from one row to the next outside the fine part


def refuse_broken(road: Road) -> None:
    """Raises LuxloopError if a user's road has no heights at the ends of its mesh."""
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
    import trimesh  # takes a seventh of a command's start, and only views need it

    vertices, faces = np.stack([x, y, z], axis=-1).reshape(-1, 3), _grid_faces(*x.shape)
    if normals is None:  # not by a Trimesh, a reference cycle whose 400 bytes a vertex of intermediate results outlive it
        corners = vertices[faces]
        of_faces, _ = trimesh.triangles.normals(corners)
        normals = trimesh.geometry.weighted_vertex_normals(len(vertices), faces, of_faces, trimesh.triangles.angles(corners))
    else:
        normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).reshape(-1, 3)
    return trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)


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
    # Lines that the road requires replace regular ones right beside them, which would make slivers.
    beside = np.abs(regular[:, None] - required).min(axis=1) < 0.2 * spacing
    beside[[0, -1]] = False
    return np.unique(np.concatenate([regular[~beside], required]))


def _growing(length: float, spacing: float) -> Floats:
    """Distances from the fine part outwards up to `length`, the first a little over `spacing`."""
    count = max(1, round(np.log1p(length * (GROWTH - 1) / (spacing * GROWTH)) / np.log(GROWTH)))
    steps = np.cumsum(GROWTH ** np.arange(1, count + 1))
    return np.asarray(length * steps / steps[-1], np.float64)


@dataclass(frozen=True, eq=False)
class Ground:
    """A road that is meshed when somebody looks at it. albedo, texture: as those of a `Body`."""

    road: Road
    albedo: float
    texture: Texture | SpottedTexture | None
    name: ClassVar[str] = "road"
    track: ClassVar[PoseTrack] = PoseTrack.static()

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Instance, ...]:
        """What is in sight of a vehicle at `T_world_ground` `[4, 4]`, as parts of the body `object_id`."""
        raise NotImplementedError

    def _instance(self, object_id: int, mesh: "trimesh.Trimesh") -> Instance:
        body = Body(self.name, mesh, self.albedo, self.texture, smooth=True, ground=True)
        return Instance(object_id, body, torch.eye(4, dtype=torch.float64))


@dataclass(frozen=True, eq=False)
class StandingRoad(Ground):
    """A road meshed as a whole. Raises LuxloopError of a road that has no heights."""

    def __post_init__(self) -> None:
        refuse_broken(self.road)

    @cached_property
    def _road(self) -> Callable[[int], Instance]:
        """`_make`, memoised."""
        return keeping(1, self._make)

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Instance, ...]:
        return (self._road(object_id),)

    def _make(self, object_id: int) -> Instance:
        return self._instance(object_id, road_mesh(self.road))


LENGTH_M: Final = 6.0  # of a tile
SIGHT_M: Final = 90.0
NEAR_M: Final = 30.0  # nearer than this the light on the road is evaluated
ALONG_M: Final = (0.1, 0.6)  # spacing of rows, near and far: in a camera at 1.35 m a pixel is 0.2 m long at 17 m, 1 m at 40 m
ACROSS_M: Final = 0.12
BESIDE_M: Final = (3.5, 25.0)  # to both sides of the course: finely meshed, and meshed at all
AROUND_M: Final = 5.0  # objects, beyond their middle
TILES_IN_SIGHT: Final = 4  # times the tiles that are in sight


@dataclass(frozen=True, eq=False)
class RoadTiles(Ground):
    """A road meshed along the vehicle's course, in fine and coarse tiles.

    course_y_m: least and greatest y of its course. others_y_m: y of other objects on it. sight_m: mesh length ahead.
    """

    course_y_m: tuple[float, float]
    others_y_m: tuple[float, ...] = ()
    sight_m: float = SIGHT_M

    @cached_property
    def _edges_m(self) -> tuple[float, float]:
        """Least and greatest y of the mesh."""
        (low, high), wide = self.course_y_m, BESIDE_M[1]
        others_y_m = [y + side for y in self.others_y_m for side in (-AROUND_M, AROUND_M)]
        return min((low - wide, *others_y_m)), max((high + wide, *others_y_m))

    @cached_property
    def _tile(self) -> Callable[[int, int, bool], Instance]:
        """`_make`, memoised for the last tiles."""
        return keeping(TILES_IN_SIGHT * math.ceil(self.sight_m / LENGTH_M), self._make)

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Instance, ...]:
        (cos, sin), (x, y) = T_world_ground[:2, 0].tolist(), T_world_ground[:2, 3].tolist()
        tiles = list[Instance]()
        for k in range(int((x - self.sight_m) // LENGTH_M), int((x + self.sight_m) // LENGTH_M) + 1):
            start, stop = k * LENGTH_M, (k + 1) * LENGTH_M
            if max((end - x) * cos + (side - y) * sin for end in (start, stop) for side in self._edges_m) > 0:
                far = max(start - x, x - stop) > NEAR_M
                tiles.append(self._tile(object_id, k, far))
        return tuple(tiles)

    def _make(self, object_id: int, k: int, far: bool) -> Instance:
        """Rows share their columns at all distances, so that tiles meet without gaps; normals look one row beyond the tile."""
        grid = self.road.grid()
        x = _lines(k * LENGTH_M, LENGTH_M, ALONG_M[far], grid.x_lines_m)
        (low, high), fine = self.course_y_m, BESIDE_M[0]
        y = axis(self._edges_m, (low - fine, high + fine), ACROSS_M, grid.y_lines_m)
        margin = ALONG_M[0]
        around = np.concatenate([[x[0] - margin], x, [x[-1] + margin]])
        z = self.road.z(around[:, None], y)
        dx, dy = np.gradient(z, around, y)
        normals = np.stack([-dx, -dy, np.ones_like(z)], axis=-1)
        return self._instance(object_id, grid_mesh(*np.meshgrid(x, y, indexing="ij"), z[1:-1], normals[1:-1]))


SIDE_M: Final = 12.0  # of a patch
PATCH_BESIDE_M: Final = 40.0  # to both sides of where the vehicle heads
PATCH_NEAR_M: Final = 24.0  # up to which patches are fine
SPACING_M: Final = (0.2, 1.2)  # of rows and columns, near and far
SKIRT_M: Final = 0.1  # height of the skirt that hides gaps between fine and coarse patches
MOST_PATCHES: Final = 400  # patches, four times those in sight


@dataclass(frozen=True, eq=False)
class RoadPatches(Ground):
    """A road meshed around the vehicle, in fine and coarse patches. sight_m: mesh length ahead."""

    sight_m: float = SIGHT_M

    @cached_property
    def _patch(self) -> Callable[[int, int, int, bool], Instance]:
        """`_make`, memoised for the last patches."""
        return keeping(MOST_PATCHES, self._make)

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Instance, ...]:
        (cos, sin), place = T_world_ground[:2, 0].tolist(), T_world_ground[:2, 3].numpy()
        reach = math.ceil((self.sight_m + SIDE_M) / SIDE_M)
        i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1) + np.floor(place / SIDE_M).astype(int)[:, None]
        x, y = (SIDE_M * (np.stack([i, j]) + 0.5)) - place[:, None]
        ahead, left, half = cos * x + sin * y, cos * y - sin * x, SIDE_M * math.sqrt(0.5)
        seen = (ahead > -half) & (ahead < self.sight_m + half) & (abs(left) < PATCH_BESIDE_M + half)
        far = np.hypot(np.clip(abs(x) - SIDE_M / 2, 0, None), np.clip(abs(y) - SIDE_M / 2, 0, None)) > PATCH_NEAR_M
        places = zip(i[seen].tolist(), j[seen].tolist(), far[seen].tolist(), strict=True)
        return tuple(self._patch(object_id, *place) for place in places)

    def _make(self, object_id: int, i: int, j: int, far: bool) -> Instance:
        """Normals look one row beyond the patch."""
        grid, spacing = self.road.grid(), SPACING_M[far]
        x, y = (_lines(k * SIDE_M, SIDE_M, spacing, lines) for k, lines in ((i, grid.x_lines_m), (j, grid.y_lines_m)))
        around_x, around_y = (np.concatenate([[each[0] - spacing], each, [each[-1] + spacing]]) for each in (x, y))
        z = self.road.z(around_x[:, None], around_y)
        height_and_slopes = np.stack([z, *np.gradient(z, around_x, around_y)])[:, 1:-1, 1:-1]
        grids = (*np.meshgrid(x, y, indexing="ij"), *height_and_slopes)
        X, Y, Z, dx, dy = (np.pad(each, 1, mode="edge") for each in grids)
        Z = Z - np.pad(np.zeros((len(x), len(y))), 1, constant_values=SKIRT_M)
        return self._instance(object_id, grid_mesh(X, Y, Z, np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)))


def _lines(start: float, length: float, spacing: float, required: tuple[float, ...]) -> Floats:
    """Grid lines in m from a start over a length, with those that the road requires."""
    regular = np.linspace(start, start + length, round(length / spacing) + 1)
    return np.unique(np.concatenate([regular, [line for line in required if start < line < start + length]]))
