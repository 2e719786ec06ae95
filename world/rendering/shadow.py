"""How far the light of a lamp gets, as a map: for the many points of the air in a beam. Surfaces are asked for by rays, see `raycast`."""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.rendering.face_source import FaceSource
from luxloop.world.rendering.raycast import depths
from luxloop.world.scene.triangles import Triangles
from luxloop.world.view import View


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """depth: `[height, width]` float32 m along the lamp's optical axis at the texels' centres, infinite where nothing is hit."""

    view: View
    depth: Tensor


def shadow_map(triangles: Triangles, view: View, source: FaceSource) -> ShadowMap:
    """The shadow map of a lamp that looks through `view`, whose width and height are the map's resolution."""
    face_ids = source.face_ids(triangles, view)
    depth = depths(triangles, face_ids.flatten(), view.origin, view.rays().flatten(1))
    return ShadowMap(view, depth.float().view(view.height, view.width))


def visible(shadow: ShadowMap, points: Tensor) -> Tensor:
    """Which world points `[..., 3, N]` in m see the lamp, `[..., N]` bool, to a texel; outside the map all do, having no light from it."""
    image, depth = shadow.view.project(points)
    column, row = image[..., 0, :], image[..., 1, :]
    inside = (depth > 0) & (column >= 0) & (column < shadow.view.width) & (row >= 0) & (row < shadow.view.height)
    farthest = shadow.depth[torch.where(inside, row, 0).long(), torch.where(inside, column, 0).long()]
    return ~inside | (depth <= farthest)
