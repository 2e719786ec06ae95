"""G-buffer: what a view sees at each pixel, whichever way its faces were found."""

from dataclasses import dataclass

import torch
from torch import Tensor

from world.frames import inverse, transform
from world.triangles import Triangles, intersect
from world.view import View


@dataclass(frozen=True)
class GBuffer:
    """Surfaces at the pixel centres of a view; all zero where there is none.

    position: `[3, height, width]` m, world. normal: `[3, height, width]`, unit, world, on the side that is seen of two-sided bodies.
    albedo: `[height, width]`. object_id: `[height, width]` int32, index of the body in the scene, -1 = none.
    """

    position: Tensor
    normal: Tensor
    albedo: Tensor
    object_id: Tensor

    def to(self, device: torch.device) -> "GBuffer":
        return GBuffer(self.position.to(device), self.normal.to(device), self.albedo.to(device), self.object_id.to(device))


def gbuffer(triangles: Triangles, view: View, face_ids: Tensor) -> GBuffer:
    """Intersect the ray through each pixel's centre with the face `[height, width]` that it sees; float64 inside, float32 out."""
    n = view.height * view.width
    position, normal, albedo = torch.zeros(3, n), torch.zeros(3, n), torch.zeros(n)
    object_id = torch.full((n,), -1, dtype=torch.int32)
    origin, directions = view.origin, view.rays().flatten(1)
    for hits in intersect(triangles, face_ids.flatten(), origin, directions):
        placed, pixels = hits.placed, hits.pixels
        points = origin[:, None] + directions[:, pixels] * hits.depth
        position[:, pixels] = points.float()
        normals = _normals(placed.corner_normals[hits.faces], hits.barycentric.float())
        normal[:, pixels] = torch.where(hits.front, normals, -normals) if placed.body.two_sided else normals
        texture = placed.body.texture
        if texture is None:
            albedo[pixels] = placed.body.albedo
        else:
            x, y, _ = transform(inverse(placed.T_world_body), points)
            albedo[pixels] = texture.at(x, y)
        object_id[pixels] = placed.object_id
    shape = (view.height, view.width)
    return GBuffer(position.view(3, *shape), normal.view(3, *shape), albedo.view(shape), object_id.view(shape))


def _normals(corner_normals: Tensor, barycentric: Tensor) -> Tensor:
    """Unit normals `[3, M]` from those at the corners `[M, 3 corners, 3]` and barycentric coordinates `[3 corners, M]`."""
    weight = barycentric.clamp(min=0.0)
    mean = torch.stack([weight[i] * corner_normals[:, i].T for i in range(3)]).sum(0)
    return torch.nn.functional.normalize(mean, dim=0)
