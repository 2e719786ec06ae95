"""Rectangles for lighting functions: faces of boxes, strips and areas on the road; batch dimensions first."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives, Quantity, rectangle


@dataclass(frozen=True)
class Place:
    """Rectangles `[..., 3]` m in the world: a corner, the edges along symbol u and v, and the unit normal of the side that takes light.

    For a reader u points right and v down, so the normal towards the reader is -d1 x d2.
    """

    origin: Tensor
    d1: Tensor
    d2: Tensor
    normal: Tensor

    def light(self, value: float, quantity: Quantity, **keys: Any) -> Primitives:
        """A primitive on the rectangle. value: setpoint at symbol value 1. keys: further arguments of `rectangle`."""
        return rectangle(self.origin, self.d1, self.d2, value, quantity, normal=self.normal, **keys)


def cuboid(T_world_box: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The six faces of a box, origin, d1 and d2 `[..., 6, 3]` m, `d1 x d2` outward: front, back, left, right, top, bottom.

    T_world_box: `[..., 4, 4]`. low, high: `[..., 3]` m, opposite corners in the box's frame.
    """
    low, high = torch.broadcast_tensors(low.to(T_world_box), high.to(T_world_box))
    size = high - low
    zero = torch.zeros_like(size[..., 0])
    x, y, z = (torch.stack([size[..., i] if i == k else zero for i in range(3)], -1) for k in range(3))
    at_low = torch.stack([low] * 3, -2)
    far = torch.stack([low + x, low + y, low + z], -2)
    u, v = torch.stack([y, z, x], -2), torch.stack([z, x, y], -2)
    # Each lower side swaps u and v, which reverses the normal.
    origin, d1, d2 = (torch.stack([a, b], -2).flatten(-3, -2) for a, b in ((far, at_low), (u, v), (v, u)))
    R = T_world_box[..., :3, :3].transpose(-1, -2)
    return origin @ R + T_world_box[..., None, :3, 3], d1 @ R, d2 @ R


def strip(T_world_road: Tensor, start: Tensor, stop: Tensor, width_m: float) -> Place:
    """A rectangle `[..., 3]` on the road between the middles of its near and far side; image row 0 lies at the far side.

    T_world_road: `[4, 4]`, frame whose plane z = 0 is the road. start, stop: `[..., 2]` m in this frame, middles of near and far side.
    """
    along = stop - start
    right = torch.stack([along[..., 1], -along[..., 0]], -1)
    d1 = width_m * torch.nn.functional.normalize(right, dim=-1)
    return on_road(T_world_road, stop - d1 / 2, d1, -along)


def on_road(T_world_road: Tensor, origin: Tensor, d1: Tensor, d2: Tensor) -> Place:
    """A rectangle on the road in the world, from origin, d1 and d2 `[..., 2]` m in the road's plane."""
    T = T_world_road.to(origin)
    p, a, b = (torch.nn.functional.pad(v, (0, 1)) @ T[:3, :3].T for v in (origin, d1, d2))
    return Place(p + T[:3, 3], a, b, T[:3, 2])


def facing(T_world_box: Tensor, bounds: Tensor, viewer: Tensor) -> Place:
    """An upright rectangle `[3]` through the centre of a box, facing the viewer `[3]` m, of the box's apparent width and height.

    bounds: `[2, 3]` m, opposite corners in the box's frame.
    """
    (low, high), viewer = bounds.to(T_world_box), viewer.to(T_world_box)
    up = T_world_box[:3, 2]
    middle = T_world_box[:3, :3] @ ((low + high) / 2) + T_world_box[:3, 3]
    to_viewer = viewer - middle
    normal = torch.nn.functional.normalize(to_viewer - (to_viewer @ up) * up, dim=0)
    left = torch.linalg.cross(normal, up)  # the viewer's left
    length, width = ((T_world_box[:3, k] @ left).abs() * (high - low)[k] for k in (0, 1))
    d1, d2 = -(length + width) * left, -(high - low)[2] * up
    return Place(middle - (d1 + d2) / 2, d1, d2, normal)
