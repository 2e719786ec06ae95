"""Errors of light against wanted light: MAE, RMSE, MARE, structural similarity (T 8.3), and intersection over union."""

import math

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError

MARE_OFFSET = 1e-12  # cd; a texel that should be dark counts with its light over this


def mae(actual: Tensor, wanted: Tensor) -> Tensor:
    """Mean absolute error of light textures `[..., H, W]` (T eq. 8.3.1), `[...]`.

    It is divided by the number of texels with a positive setpoint and by the largest setpoint, so that neither the size of the texture
    nor the setpoint's unit matters.

    Raises: LuxloopError where an image has no positive setpoint.
    """
    return (actual - wanted).abs().sum((-2, -1)) / (_lit(wanted) * wanted.amax((-2, -1)))


def rmse(actual: Tensor, wanted: Tensor) -> Tensor:
    """Root of the mean squared error of light textures `[..., H, W]` (T eq. 8.3.2), `[...]`; divided as `mae`, raises as `mae`."""
    return ((actual - wanted).square().sum((-2, -1)) / _lit(wanted)).sqrt() / wanted.amax((-2, -1))


def mare(actual: Tensor, wanted: Tensor) -> Tensor:
    """Mean absolute relative error of light textures `[..., H, W]` in cd (T eq. 8.3.3), `[...]`; raises what `mae` raises.

    Light on texels with setpoint zero is divided by an offset of 1e-12 cd only and dominates the result: values of 1e12 are common.
    """
    return ((actual - wanted).abs() / (wanted + MARE_OFFSET)).sum((-2, -1)) / _lit(wanted)


def _lit(wanted: Tensor) -> Tensor:
    """Number of texels with a positive setpoint, `[...]`."""
    number = (wanted > 0).sum((-2, -1))
    if bool((number == 0).any()):
        raise LuxloopError("an error relative to the setpoint needs a texel with a positive setpoint; this one is dark everywhere")
    return number


def ssim(a: Tensor, b: Tensor, radius: float, data_range: float) -> Tensor:
    """Structural similarity of `[..., H, W]` images, `[...]` in [-1, 1]; 1 where they are equal (Wang et al. 2004, T 8.3).

    radius: standard deviation in px of the Gaussian window, which ends at `ceil(3 radius)` and sees the border replicated.
    data_range: span of the images' values, in their unit. Mean over all pixels.
    Raises: LuxloopError if radius or data_range is not positive.
    """
    if radius <= 0 or data_range <= 0:
        raise LuxloopError(f"SSIM needs a positive radius and data_range, got {radius} and {data_range}")
    a, b = torch.broadcast_tensors(a, b)
    mean_a, mean_b, mean_aa, mean_bb, mean_ab = gaussian(torch.stack([a, b, a * a, b * b, a * b]), radius)
    covariance = mean_ab - mean_a * mean_b
    variances = (mean_aa - mean_a**2) + (mean_bb - mean_b**2)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    similarity = (2 * mean_a * mean_b + c1) * (2 * covariance + c2) / ((mean_a**2 + mean_b**2 + c1) * (variances + c2))
    return similarity.mean((-2, -1))


def dssim(a: Tensor, b: Tensor, radius: float, data_range: float) -> Tensor:
    """Structural dissimilarity `(1 - ssim) / 2`, `[...]` in [0, 1] (T 8.3)."""
    return (1 - ssim(a, b, radius, data_range)) / 2


def iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of boolean masks `[..., H, W]`, `[...]` float32 in [0, 1]; two empty masks agree, which is 1."""
    intersection = (a & b).sum((-2, -1))
    union = (a | b).sum((-2, -1))
    return torch.where(union > 0, intersection / union.clamp(min=1), 1.0)


def gaussian(images: Tensor, radius: float) -> Tensor:
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
