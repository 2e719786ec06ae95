"""The road's shape in four numbers: what an acquisition finds, before single heights are known.

The road is `z = a + b (x - x0) + c y + d (x - x0)^2 / 2`, with the shape `[4]` = a in m, b and c without unit, d in 1/m, about x0 in m.
"""

import torch
from torch import Tensor


def reached(shape: Tensor, x0_m: float, origin: Tensor, rays: Tensor) -> Tensor:
    """Multiples `[k, ...]` of rays `[3, ...]` from an origin `[3]` m at which these meet roads of shapes `[k, 4]`, infinite for nowhere.

    With the ray put into the road's equation that is a quadratic's first positive root, in the form that also holds without curvature.
    """
    a, b, c, d = (each.view(-1, *(1,) * (rays.dim() - 1)) for each in shape.unbind(-1))
    x = origin[0] - x0_m
    square = d / 2 * rays[0] ** 2
    slope = (b + d * x) * rays[0] + c * rays[1] - rays[2]
    height = a + b * x + c * origin[1] + d / 2 * x**2 - origin[2]  # of the road over the origin, negative
    root = (slope**2 - 4 * square * height).clamp(min=0).sqrt()
    below = slope + root
    meets = (slope**2 >= 4 * square * height) & (below > 0) & (height < 0)
    return torch.where(meets, -2 * height / below.clamp(min=1e-9), torch.inf)


def height(shape: Tensor, x0_m: float, x: Tensor, y: Tensor) -> Tensor:
    """Height in m of a road of shape `[4]` at x and y in m, broadcast."""
    a, b, c, d = shape
    return a + b * (x - x0_m) + c * y + d / 2 * (x - x0_m) ** 2
