"""Metrics: errors of light against a goal (T 8.3), visibility of objects (T 9.2), and the quality of a symbol on the road.

Metrics of a symbol are computed from noise-free light, independent of a controller's extraction.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d

from luxloop.perception.appearance import Appearance, appearance
from luxloop.perception.birdseye import BirdsEye, hull, rectify, span
from luxloop.world.errors import LuxloopError

MARE_OFFSET = 1e-12  # cd; divisor of the error at texels that should be dark


def mae(actual: Tensor, wanted: Tensor) -> Tensor:
    """Mean absolute error of light textures `[..., H, W]` (T eq. 8.3.1), `[...]`.

    The sum is divided by the number of texels with a positive setpoint and by the largest setpoint, so that neither the size of the texture
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
    a = a.expand(np.broadcast_shapes(a.shape, b.shape))  # torch.broadcast_shapes would import sympy
    mean_a, mean_aa, mean_ab = gaussian(torch.stack([a, a * a, a * b]), radius)
    mean_b, mean_bb = gaussian(torch.stack([b, b * b]), radius)
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


RING_PX = 6  # width of the ring around an object that counts as its background


def ring(mask: Tensor, px: int = RING_PX) -> Tensor:
    """Ring of pixels `[height, width]` bool within px of an object. mask: of the object, `[height, width]` bool."""
    wider = max_pool2d(mask[None].float(), 2 * px + 1, 1, px)[0] > 0
    return wider & ~mask


def weber_contrast(luminance: Tensor, mask: Tensor, floor: float) -> Tensor:
    """`|L_o - L_b| / (L_b + floor)`, a scalar, of the mean luminances of an object and of the ring around it.

    luminance: `[height, width]` cd/m^2. floor: luminance indistinguishable from black, so that contrast in the dark counts nothing.
    """
    own, background = luminance[mask].mean(), luminance[ring(mask)].mean()
    return (own - background).abs() / (background + floor)


def edge_definition(luminance: Tensor, mask: Tensor, floor: float) -> Tensor:
    """Mean steepness of the logarithm of `L + floor` along an object's outline, per px, a scalar."""
    log = (luminance + floor).log()
    steps = torch.stack([log[1:, :-1] - log[:-1, :-1], log[:-1, 1:] - log[:-1, :-1]])
    outline = (mask[1:, :-1] ^ mask[:-1, :-1]) | (mask[:-1, 1:] ^ mask[:-1, :-1])
    return (steps[:, outline].square().sum(0) + 1e-12).sqrt().mean()


def unevenness(light: Tensor, mask: Tensor, floor: float) -> Tensor:
    """Standard deviation over the mean plus floor of light `[height, width]` on an object, a scalar: 0 for homogeneous light."""
    return light[mask].std(correction=0) / (light[mask].mean() + floor)


THRESHOLD = 0.25  # of the target's median: far parts of a symbol are several times darker than near ones
CELL_M = 0.02  # at 4 cm the mask's edges would jump by half a percent of the symbol's length
SSIM_RADIUS = 2.0  # pairs of cells


@dataclass(frozen=True)
class Target:
    """The symbol at its target on a flat road, in the bird's-eye view.

    luminance: `[rows, cols]` cd/m^2. median: `[]` cd/m^2, of the lit cells. mask: `[rows, cols]` bool. shape: moments of the mask. rows,
    cols: part of the view that the light reaches.
    """

    luminance: Tensor
    median: Tensor
    mask: Tensor
    shape: Appearance
    rows: slice
    cols: slice
    length_m: float
    width_m: float


@dataclass(frozen=True)
class Metrics:
    """The evaluator's metrics, all `[...]`.

    centroid_percent: `[..., 2]`, signed error along x in % of the symbol's length and along y in % of its width. iou, ssim: 0..1.
    length: ratio to the target's second-moment length. shear: mu11 / mu20 in the plane.
    """

    centroid_percent: Tensor
    iou: Tensor
    ssim: Tensor
    length: Tensor
    shear: Tensor


def target(luminance: Tensor, view: BirdsEye, length_m: float, width_m: float) -> Target:
    """The target from the noise-free camera luminance `[height, width]` of the symbol alone, at its target on a flat road."""
    plane = rectify(view, luminance)
    median = plane[plane > THRESHOLD * plane.max()].median()
    mask = plane > THRESHOLD * median
    rows, cols = view.cells_of(*_lit_part(luminance))
    part = around(rows, cols, mask.shape)
    return Target(plane, median, mask, appearance(mask[part].to(plane), view.within(*part).axes), rows, cols, length_m, width_m)


def evaluate(luminance: Tensor, view: BirdsEye, goal: Target, u_start: int = 0, v_start: int = 0) -> Metrics:
    """Metrics of the noise-free on-minus-off camera luminance `[..., height, width]` in cd/m^2; NaN if nothing is lit.

    luminance: of the whole image, or of a crop that starts at (u_start, v_start) px and is dark beyond. Only the part of the view with this
    light or the target's is computed, one part for a whole batch.
    """
    v, u = _lit_part(luminance)
    luminance, u_start, v_start = luminance[..., v, u], u_start + u.start, v_start + v.start
    height, width = luminance.shape[-2:]
    found = view.cells_of(slice(v_start, v_start + height), slice(u_start, u_start + width))
    part = around(hull(found[0], goal.rows), hull(found[1], goal.cols), goal.mask.shape)
    seen, wanted = view.within(*part), goal.mask[part]
    plane = rectify(seen, luminance, u_start, v_start) if luminance.numel() else luminance.new_zeros(*luminance.shape[:-2], *wanted.shape)
    mask = plane > THRESHOLD * goal.median
    shape = appearance(mask.to(plane), seen.axes)
    offset = shape.centroids[..., 0, :] - goal.shape.centroids[0]
    size = torch.tensor([goal.length_m, goal.width_m]).to(offset)
    grey, goal_grey = (_in_pairs((image / goal.median / 2).clamp(0, 1)) for image in (plane, goal.luminance[part]))
    share = goal_grey.numel() / math.prod(n // 2 for n in goal.mask.shape)  # of the view; elsewhere both are dark, and the similarity is 1
    return Metrics(
        -100 * offset.flip(-1) / size,
        iou(mask, wanted.expand_as(mask)),
        1 - share * (1 - ssim(grey, goal_grey, SSIM_RADIUS, 1.0)),
        shape.length / goal.shape.length,
        shape.shear,
    )


def _lit_part(luminance: Tensor) -> tuple[slice, slice]:
    """Rows and columns that contain the light of all images `[..., height, width]`."""
    image = luminance.detach().abs()
    if not image.numel():
        return slice(0, 0), slice(0, 0)
    rows = span(image.reshape(-1, *image.shape[-2:]).amax((0, -1)) > 0)
    if rows.stop == rows.start:
        return rows, rows
    return rows, span(image[..., rows, :].reshape(-1, image.shape[-1]).amax(0) > 0)


def around(rows: slice, cols: slice, shape: Sequence[int]) -> tuple[slice, slice]:
    """Rows and columns of a view that SSIM's window of a part reaches, in whole pairs of cells; shape: rows and columns of the view."""
    window = 2 * math.ceil(3 * SSIM_RADIUS)
    top, left = (max(each.start // 2 * 2 - window, 0) for each in (rows, cols))
    bottom, right = (min(-(-each.stop // 2) * 2 + window, n) for each, n in zip((rows, cols), shape, strict=True))
    return slice(top, bottom), slice(left, right)


def _in_pairs(image: Tensor) -> Tensor:
    """Means of 2 x 2 cells, `[..., rows / 2, cols / 2]`."""
    return avg_pool2d(image.reshape(-1, 1, *image.shape[-2:]), 2).reshape(*image.shape[:-2], image.shape[-2] // 2, image.shape[-1] // 2)
