"""Image regions of places in the world."""

import torch
from torch import Tensor

from luxloop.world.frames import View, inverse


def box_region(view: View, T_world_box: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Pixels whose centres see a box, `[height, width]` bool, ignoring occlusion.

    T_world_box: `[4, 4]`. low, high: `[3]` m, opposite corners in the box's frame; equal along one axis of a rectangle. A ray hits the box
    where it is between all three pairs of planes at once (slab method).
    """
    T = inverse(T_world_box.to(view.T_world_view))
    eye = T[:3, :3] @ view.origin + T[:3, 3]
    rays = torch.einsum("ij,jhw->ihw", T[:3, :3], view.rays())
    rays = torch.where(rays == 0, torch.finfo(rays.dtype).tiny, rays)
    first, second = ((corner.to(eye) - eye)[:, None, None] / rays for corner in (low, high))
    enter, leave = torch.minimum(first, second).amax(0), torch.maximum(first, second).amin(0)
    return (enter <= leave) & (leave > 0)
