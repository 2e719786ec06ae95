"""Embree's copy of a triangle mesh: the first faces that rays meet, which embree finds in float32, and their depths in float64."""

import numpy as np
import torch
from torch import Tensor

STEP_M = 1e-4  # along a ray, past the back of a face; embree's float32 is good to 1e-5 m within 100 m


class EmbreeMesh:
    """A mesh as an embree scene for ray casting."""

    def __init__(self, vertices: Tensor, faces: Tensor, two_sided: Tensor) -> None:
        """vertices: `[V, 3]` float64 m. faces: `[F, 3]` int64, corners counter-clockwise.

        two_sided: `[F]` bool, faces that are met from the back as well.
        """
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene, self._vertices, self._faces, self._two_sided = EmbreeScene(), vertices, faces, two_sided
        TriangleMesh(self._scene, vertices.float().numpy(), faces.int().numpy())

    def cast(self, origin: Tensor, directions: Tensor, farthest: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Rays `[M]` that meet a face, these faces, their depth in lengths of the directions, and those lengths across the face in m.

        origin: `[3]` m float64, common to all rays, or `[3, N]`. directions: `[3, N]` float64. farthest: `[N]` float32 lengths of them.
        A face that is met from behind and not two-sided is passed, so that one sees out of a closed body.
        """
        rays, start, step_m = torch.arange(directions.shape[1]), torch.zeros(directions.shape[1], dtype=torch.float64), STEP_M
        d, o = directions, origin.view(3, -1)  # [3, n], [3, 1 or n]
        origins = o.T.expand(len(rays), 3)  # [n, 3]
        met = [(rays[:0], rays[:0], start[:0], start[:0])]
        while len(rays):
            face = torch.from_numpy(self._scene.run(_array(origins), _array(d.T), _array(farthest[rays] - start[rays])))
            hit = torch.nonzero(face >= 0)[:, 0]
            rays, d, face, o = rays[hit], d.index_select(1, hit), face[hit].long(), o if o.shape[1] == 1 else o[:, hit]
            a, b, c = self._vertices[self._faces[face]].permute(1, 2, 0)  # [3, n]
            normal = torch.linalg.cross(b - a, c - a, dim=0)  # out of the side that is seen
            towards = (normal * d).sum(0)
            depth = (normal * (a - o)).sum(0) / towards  # t where n (o + t d - a) = 0, [n]
            front = (towards < 0) | self._two_sided[face]
            met.append((rays[front], face[front], depth[front], (towards.abs() / normal.norm(dim=0))[front]))
            back = ~front
            rays, d, depth, o = rays[back], d[:, back], depth[back], o if o.shape[1] == 1 else o[:, back]
            start[rays] = torch.maximum(start[rays], depth) + step_m / d.norm(dim=0)
            origins = (o + d * start[rays]).T
            step_m *= 2  # so that rounding holds no ray up
        rays, faces, depths, across = map(torch.cat, zip(*met, strict=True))
        return rays, faces, depths, across


def _array(values: Tensor) -> np.ndarray:
    return np.ascontiguousarray(values.float().numpy())
