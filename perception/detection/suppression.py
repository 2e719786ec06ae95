"""Non-maximum suppression of overlapping boxes."""

import torch
from torch import Tensor

SAME = 0.3  # least overlap of a box with the object that it is said to show


def overlaps(boxes: Tensor, others: Tensor) -> Tensor:
    """Intersection over union `[..., n, m]` of boxes `[..., n, 4]` and others `[..., m, 4]`: left, top, right, bottom; 0 of empty ones."""
    low = torch.maximum(boxes[..., :, None, :2], others[..., None, :, :2])
    high = torch.minimum(boxes[..., :, None, 2:], others[..., None, :, 2:])
    both = (high - low).clamp(min=0).prod(-1)
    areas = [(each[..., 2:] - each[..., :2]).clamp(min=0).prod(-1) for each in (boxes, others)]
    return both / (areas[0][..., :, None] + areas[1][..., None, :] - both).clamp(min=1e-9)


def suppress(boxes: Tensor, overlap: float) -> Tensor:
    """Boxes `[..., n, 4]`, by descending score, that overlap one of higher score with an IoU above `overlap`: `[..., n]` bool (Fast NMS,
    Bolya 2019).

    A box suppresses others even if it is suppressed itself, so that all are compared at once.
    """
    return overlaps(boxes, boxes).triu(1).amax(-2) > overlap
