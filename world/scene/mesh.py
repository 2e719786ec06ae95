"""Triangle meshes as arrays. `trimesh.Trimesh` has the same attributes; only mesh files need it, as its import takes 0.3 s."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch.nn.functional import normalize

from luxloop.world.roads.base import Floats


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices: `[V, 3]` m. faces: `[F, 3]` of vertices, counter-clockwise from outside. normals: `[V, 3]`, None for those of the faces."""

    vertices: Floats
    faces: NDArray[np.int64]
    normals: Floats | None = None

    @cached_property
    def vertex_normals(self) -> Floats:
        """Unit normals `[V, 3]`, by default the mean over the faces about a vertex, weighted by their angles there."""
        if self.normals is not None:
            return self.normals
        faces, corners = torch.from_numpy(self.faces), torch.from_numpy(self.vertices[self.faces])  # [F, 3], [F, 3 corners, 3]
        sides = normalize(corners.roll(-1, 1) - corners, dim=-1)  # to the next corner
        angles = torch.arccos((-sides * sides.roll(1, 1)).sum(-1).clamp(-1, 1))
        weighted = angles[..., None] * normalize(torch.linalg.cross(sides[:, 0], sides[:, 1]), dim=-1)[:, None]
        summed = torch.zeros(len(self.vertices), 3, dtype=torch.float64).index_add_(0, faces.flatten(), weighted.flatten(0, 1))
        return normalize(summed, dim=-1).numpy()


CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = np.array(
    [[1, 3, 0], [4, 1, 0], [0, 3, 2], [2, 4, 0], [1, 7, 3], [5, 1, 4], [5, 7, 1], [3, 7, 2], [6, 4, 2], [2, 7, 6], [6, 5, 4], [7, 5, 6]]
)


def box(size_m: ArrayLike, centre_m: ArrayLike = 0.0) -> Mesh:
    """A box of length (x), width (y) and height (z) `[3]` about a point `[3]`."""
    return Mesh(CUBE * np.asarray(size_m, np.float64) + np.asarray(centre_m, np.float64), FACES)
