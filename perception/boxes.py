"""Boxes in an image: `[..., 4]` px, left, top, right, bottom."""

import torch
from torch import Tensor


def overlap(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union `[..., n, m]` of each of the boxes `[..., n, 4]` with each of `[..., m, 4]`; 0 where both are empty."""
    low = torch.maximum(a[..., :, None, :2], b[..., None, :, :2])
    high = torch.minimum(a[..., :, None, 2:], b[..., None, :, 2:])
    common = (high - low).clamp(min=0).prod(-1)
    either = area(a)[..., :, None] + area(b)[..., None, :] - common
    return common / torch.where(either > 0, either, 1.0)


def area(boxes: Tensor) -> Tensor:
    """`[...]` px^2, 0 where a box is turned inside out."""
    return (boxes[..., 2:] - boxes[..., :2]).clamp(min=0).prod(-1)
