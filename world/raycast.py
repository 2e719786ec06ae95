"""The project's only ray caster: embree through trimesh, each body in its own frame, so that nothing is rebuilt when a body moves."""

import torch
from torch import Tensor

from world.frames import inverse
from world.triangles import Triangles, depths
from world.view import View


class RayCaster:
    """A face source by ray casting, where no OpenGL is to be had and as its cross-check."""

    name = "embree"

    def face_ids(self, triangles: Triangles, view: View) -> Tensor:
        """Id of the nearest face through each pixel's centre, `[height, width]` int64, -1 where there is none."""
        return first_hits(triangles, view.origin, view.rays().flatten(1)).reshape(view.height, view.width)


def first_hits(triangles: Triangles, origin: Tensor, directions: Tensor) -> Tensor:
    """Id of the first face that each ray meets, `[N]` int64, -1 where there is none.

    origin: `[3]` m, common to all rays. directions: `[3, N]`, any length. Embree computes in float32: good to some 1e-6 of a body's size.
    """
    nearest = torch.full((directions.shape[1],), -1)
    depth = torch.full((directions.shape[1],), torch.inf, dtype=torch.float64)
    for first, placed in triangles.parts():
        T_body_world = inverse(placed.T_world_body)
        local_origin = T_body_world[:3, :3] @ origin + T_body_world[:3, 3]
        local = T_body_world[:3, :3] @ directions
        rays = torch.nonzero(_near(placed.body.bounds, local_origin, local))[:, 0]
        if not len(rays):
            continue
        origins = local_origin.expand(len(rays), 3).numpy()
        face = torch.from_numpy(placed.body.intersector.intersects_first(origins, local[:, rays].T.numpy())).long()
        hit = face >= 0
        if not placed.body.two_sided:  # from within a closed body, one sees out
            a, b, c = placed.body.corners[face].unbind(1)
            hit &= (torch.linalg.cross(b - a, c - a).T * local[:, rays]).sum(0) < 0
        rays, face = rays[hit], face[hit] + first
        hit_depth = depths(triangles, face, origin, directions[:, rays])
        closer = hit_depth < depth[rays]
        nearest[rays[closer]] = face[closer]
        depth[rays[closer]] = hit_depth[closer]
    return nearest


def _near(bounds: Tensor, origin: Tensor, directions: Tensor) -> Tensor:
    """Which rays `[3, N]` pass through the sphere around a body: most miss a small one, and asking embree costs more."""
    low, high = bounds
    to_centre = (low + high) / 2 - origin
    along = to_centre @ directions
    miss2 = to_centre @ to_centre - along * along.abs() / (directions * directions).sum(0)
    return miss2 <= ((high - low) / 2).square().sum()
