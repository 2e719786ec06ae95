"""The judge: quality of a symbol on the road, from noise-free light and independent of any controller's extraction."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from luxloop.perception.appearance import Appearance, appearance
from luxloop.perception.birdseye import BirdsEye, rectify, span
from luxloop.perception.metrics import iou, ssim

THRESHOLD = 0.25  # of the target's median: far parts of a symbol are several times darker than near ones
CELL_M = 0.02  # at 4 cm the mask's edges would jump by half a percent of the symbol's length
SSIM_RADIUS = 2.0  # pairs of cells


@dataclass(frozen=True)
class Target:
    """The symbol as it should lie on a flat road, in the bird's-eye view.

    luminance: `[rows, cols]` cd/m^2. median: `[]` cd/m^2, of its lit cells. mask: `[rows, cols]` bool. shape: the mask's moments.
    rows, cols: the part of the view that its light reaches.
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
    rows, cols = view.reached(*_lit(luminance))
    part = around(rows, cols, mask.shape)
    return Target(plane, median, mask, appearance(mask[part].to(plane), view.within(*part).axes), rows, cols, length_m, width_m)


def evaluate(luminance: Tensor, view: BirdsEye, goal: Target, u_start: int = 0, v_start: int = 0) -> Metrics:
    """Judge the noise-free on-minus-off camera luminance `[..., height, width]` in cd/m^2; NaN where nothing is lit.

    luminance: of the whole image, or of a crop that starts at (u_start, v_start) px and is dark beyond. Only the part of the view in which
    this light or the target's lies is computed, the same for all of a batch.
    """
    v, u = _lit(luminance)
    luminance, u_start, v_start = luminance[..., v, u], u_start + u.start, v_start + v.start
    height, width = luminance.shape[-2:]
    found = view.reached(slice(v_start, v_start + height), slice(u_start, u_start + width))
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
        1 - share * (1 - ssim(grey, goal_grey.expand_as(grey), SSIM_RADIUS, 1.0)),
        shape.length / goal.shape.length,
        shape.shear,
    )


def _lit(luminance: Tensor) -> tuple[slice, slice]:
    """Rows and columns beyond which images `[..., height, width]` are dark, the same for all of a batch."""
    image = luminance.detach().abs()
    if not image.numel():
        return slice(0, 0), slice(0, 0)
    rows = span(image.reshape(-1, *image.shape[-2:]).amax((0, -1)) > 0)
    if rows.stop == rows.start:
        return rows, rows
    return rows, span(image[..., rows, :].reshape(-1, image.shape[-1]).amax(0) > 0)


def hull(found: slice, wanted: slice) -> slice:
    """The smallest slice that holds two, the first of which may be empty."""
    return wanted if found.stop == found.start else slice(min(found.start, wanted.start), max(found.stop, wanted.stop))


def around(rows: slice, cols: slice, shape: Sequence[int]) -> tuple[slice, slice]:
    """Whole pairs of cells of a view `[rows, cols]`, from which SSIM's window reaches a part of it."""
    window = 2 * math.ceil(3 * SSIM_RADIUS)
    top, left = (max(each.start // 2 * 2 - window, 0) for each in (rows, cols))
    bottom, right = (min(-(-each.stop // 2) * 2 + window, n) for each, n in zip((rows, cols), shape, strict=True))
    return slice(top, bottom), slice(left, right)


def _in_pairs(image: Tensor) -> Tensor:
    """Means of 2 x 2 cells, `[..., rows / 2, cols / 2]`."""
    return avg_pool2d(image.reshape(-1, 1, *image.shape[-2:]), 2).reshape(*image.shape[:-2], image.shape[-2] // 2, image.shape[-1] // 2)
