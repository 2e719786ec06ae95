"""Shadow maps: how far the light of a lamp gets."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from world.face_source import FaceSource
from world.triangles import Triangles, depths
from world.view import View

BIAS_M = 0.01


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """depth: `[height, width]` float32 m along the lamp's optical axis at the texels' centres, infinite where nothing is hit."""

    view: View
    depth: Tensor

    def to(self, device: torch.device) -> "ShadowMap":
        return ShadowMap(self.view, self.depth.to(device))


def padded(view: View) -> View:
    """A lamp's view, a texel wider to all sides, so that what the lamp lights out to its very border lies among four texels."""
    return replace(view, width=view.width + 2, height=view.height + 2, cx=view.cx + 1, cy=view.cy + 1)


def shadow_map(triangles: Triangles, view: View, source: FaceSource) -> ShadowMap:
    """The shadow map of a lamp that looks through `view`, whose width and height are the map's resolution."""
    view = padded(view)
    face_ids = source.face_ids(triangles, view)
    depth = depths(triangles, face_ids.flatten(), view.origin, view.rays().flatten(1))
    return ShadowMap(view, depth.float().view(view.height, view.width))


def visible(shadow: ShadowMap, points: Tensor, bias_m: float = BIAS_M) -> Tensor:
    """Which world points `[..., 3, N]` in m see the lamp, `[..., N]` bool; outside the map all do, having no light from it anyway.

    A point is in shadow if it lies deeper than all four texels around it. On a plane, however grazing the light, it never does: a plane's
    depth takes its largest value at one of the four. So the bias only has to cover what is rough within a texel, and shadows begin at the
    foot of what throws them; their outline is worn off by less than a texel.
    """
    image, depth = shadow.view.project(points)
    rows, columns = shadow.depth.shape
    u, v = image[..., 0, :] - 0.5, image[..., 1, :] - 0.5
    inside = (depth > 0) & (u >= -0.5) & (u < columns - 0.5) & (v >= -0.5) & (v < rows - 0.5)
    c0 = u.nan_to_num().clamp(0, columns - 1).floor().long()
    r0 = v.nan_to_num().clamp(0, rows - 1).floor().long()
    c1, r1 = (c0 + 1).clamp(max=columns - 1), (r0 + 1).clamp(max=rows - 1)
    farthest = torch.stack([shadow.depth[r, c] for r in (r0, r1) for c in (c0, c1)]).amax(0)
    return ~inside | (depth <= farthest + bias_m)
