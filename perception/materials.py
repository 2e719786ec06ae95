"""The material that each pixel of a view sees, from its G-buffer, as a perfect segmentation would give it."""

import torch
from torch import Tensor

from luxloop.world.frames import inverse, transform
from luxloop.world.materials.library import MaterialName
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.scene.triangles import Instance, Triangles


def material_picture(surfaces: GBuffer, triangles: Triangles) -> tuple[Tensor, tuple[MaterialName, ...]]:
    """Material image `[height, width]` int64 of indices in the returned names, -1 for none.

    surfaces: of `triangles`.
    """
    names: dict[MaterialName, int] = {}
    picture = torch.full(surfaces.object_id.shape, -1, dtype=torch.int64, device=surfaces.object_id.device)
    for placed in triangles.placed:
        seen = surfaces.object_id == placed.object_id
        if not bool(seen.any()):
            continue
        own, which = _materials(placed, surfaces, seen)
        known = torch.tensor([names.setdefault(name, len(names)) for name in own], device=picture.device)
        picture[seen] = known[which]
    return picture, tuple(names)


def _materials(placed: Instance, surfaces: GBuffer, seen: Tensor) -> tuple[tuple[MaterialName, ...], Tensor]:
    """Names of a body's materials, and which of them is at each of the pixels where it is seen."""
    body = placed.body
    if body.parts and surfaces.part is not None:
        return tuple(part.material for part in body.parts), surfaces.part[seen].long()
    points = surfaces.position[:, seen].double().cpu()
    if body.texture is None:
        return ("matt",), torch.zeros_like(points[0], dtype=torch.int64)
    x, y, _ = transform(inverse(placed.T_world_body), points)
    return body.texture.names, body.texture.material_at(x, y).to(seen.device)
