"""How alike two images are: structural similarity and intersection over union (T 8.3)."""

import math

import torch
from torch import Tensor

from world.errors import LuxloopError


def ssim(a: Tensor, b: Tensor, radius: float, data_range: float) -> Tensor:
    """Structural similarity of `[..., H, W]` images, `[...]` in [-1, 1]; 1 where they are equal (Wang et al. 2004, T 8.3).

    radius: standard deviation in px of the Gaussian window, which ends at `ceil(3 radius)` and sees the border replicated.
    data_range: span of the images' values, in their unit. Mean over all pixels.
    Raises: LuxloopError if radius or data_range is not positive.
    """
    if radius <= 0 or data_range <= 0:
        raise LuxloopError(f"SSIM needs a positive radius and data_range, got {radius} and {data_range}")
    a, b = torch.broadcast_tensors(a, b)
    mean_a, mean_b, mean_aa, mean_bb, mean_ab = _gaussian(torch.stack([a, b, a * a, b * b, a * b]), radius)
    covariance = mean_ab - mean_a * mean_b
    variances = (mean_aa - mean_a**2) + (mean_bb - mean_b**2)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    similarity = (2 * mean_a * mean_b + c1) * (2 * covariance + c2) / ((mean_a**2 + mean_b**2 + c1) * (variances + c2))
    return similarity.mean((-2, -1))


def dssim(a: Tensor, b: Tensor, radius: float, data_range: float) -> Tensor:
    """Structural dissimilarity `(1 - ssim) / 2`, `[...]` in [0, 1]."""
    return (1 - ssim(a, b, radius, data_range)) / 2


def iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of boolean masks `[..., H, W]`, `[...]` float32 in [0, 1]; two empty masks agree, which is 1."""
    intersection = (a & b).sum((-2, -1))
    union = (a | b).sum((-2, -1))
    return torch.where(union > 0, intersection / union.clamp(min=1), 1.0)


def _gaussian(images: Tensor, radius: float) -> Tensor:
    height, width = images.shape[-2:]
    return _window(height, radius, images) @ images @ _window(width, radius, images).mT


def _window(size: int, radius: float, like: Tensor) -> Tensor:
    """Gaussian with replicated border as a matrix `[size, size]`: two matrix products beat two convolutions."""
    half = math.ceil(3 * radius)
    offsets = torch.arange(-half, half + 1, device=like.device)
    weights = torch.exp(-0.5 * (offsets.to(like.dtype) / radius) ** 2)
    columns = (torch.arange(size, device=like.device)[:, None] + offsets).clamp(0, size - 1)
    window = torch.zeros(size, size, dtype=like.dtype, device=like.device)
    return window.scatter_add(1, columns, (weights / weights.sum()).expand(size, -1))
