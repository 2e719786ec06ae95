"""The judge: quality of a symbol on the road, from noise-free light and independent of any controller's extraction."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from perception.appearance import Appearance, appearance
from perception.birdseye import BirdsEye, rectify
from perception.metrics import iou, ssim

THRESHOLD = 0.25  # of the target's median: far parts of a symbol are several times darker than near ones
CELL_M = 0.02  # at 4 cm the mask's edges would jump by half a percent of the symbol's length
SSIM_RADIUS = 2.0  # pairs of cells


@dataclass(frozen=True)
class Target:
    """The symbol as it should lie on a flat road, in the bird's-eye view.

    luminance: `[rows, cols]` cd/m^2. median: `[]` cd/m^2, of its lit cells. mask: `[rows, cols]` bool. shape: the mask's moments.
    """

    luminance: Tensor
    median: Tensor
    mask: Tensor
    shape: Appearance
    length_m: float
    width_m: float


@dataclass(frozen=True)
class Verdict:
    """The judge's metrics, all `[...]`.

    centroid_percent: `[..., 2]`, signed error along x in % of the symbol's length and along y in % of its width. iou, ssim: 0..1.
    length: ratio to the target's second-moment length. shear: mu11 / mu20 in the plane.
    """

    centroid_percent: Tensor
    iou: Tensor
    ssim: Tensor
    length: Tensor
    shear: Tensor


def target(luminance: Tensor, view: BirdsEye, length_m: float, width_m: float) -> Target:
    """Take the noise-free camera luminance `[height, width]` of the symbol alone, on a flat road at the target."""
    plane = rectify(view, luminance)
    median = plane[plane > THRESHOLD * plane.max()].median()
    mask = plane > THRESHOLD * median
    return Target(plane, median, mask, appearance(mask.to(plane), view.axes), length_m, width_m)


def judge(luminance: Tensor, view: BirdsEye, goal: Target) -> Verdict:
    """Judge the noise-free on-minus-off camera luminance `[..., height, width]` in cd/m^2; NaN where nothing is lit."""
    plane = rectify(view, luminance)
    mask = plane > THRESHOLD * goal.median
    shape = appearance(mask.to(plane), view.axes)
    offset = shape.centroids[..., 0, :] - goal.shape.centroids[0]
    size = torch.tensor([goal.length_m, goal.width_m]).to(offset)
    return Verdict(
        -100 * offset.flip(-1) / size,
        iou(mask, goal.mask.expand_as(mask)),
        _similarity(plane, goal),
        shape.length / goal.shape.length,
        shape.shear,
    )


def _similarity(plane: Tensor, goal: Target) -> Tensor:
    """SSIM `[...]` of luminance `[..., rows, cols]` and target; computed where its window reaches any light, elsewhere it is 1."""
    lit = (plane > 0).reshape(-1, *plane.shape[-2:]).any(0) | (goal.luminance > 0)
    rows, cols = (_reached(lit.any(axis)) for axis in (1, 0))
    grey, goal_grey = (_in_pairs((image[..., rows, cols] / goal.median / 2).clamp(0, 1)) for image in (plane, goal.luminance))
    share = goal_grey.numel() / (lit.shape[0] // 2 * (lit.shape[1] // 2))
    return 1 - share * (1 - ssim(grey, goal_grey.expand_as(grey), SSIM_RADIUS, 1.0))


def _reached(lit: Tensor) -> slice:
    """Slice of whole pairs of cells from which SSIM's window reaches a lit cell of `[n]`; all if none is lit."""
    found, window = lit.nonzero(), math.ceil(3 * SSIM_RADIUS)
    if not len(found):
        return slice(0, 2 * (len(lit) // 2))
    first, last = int(found[0]) // 2, int(found[-1]) // 2
    return slice(2 * max(first - window, 0), 2 * min(last + window + 1, len(lit) // 2))


def _in_pairs(image: Tensor) -> Tensor:
    """Means of 2 x 2 cells, `[..., rows / 2, cols / 2]`."""
    return avg_pool2d(image.reshape(-1, 1, *image.shape[-2:]), 2).reshape(*image.shape[:-2], image.shape[-2] // 2, image.shape[-1] // 2)
