"""Outputs of networks of the YOLO families, read as boxes and scores."""

from collections.abc import Mapping
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import one_hot

Layout = Literal["yolov5", "yolov8", "yolov10"]
LAYOUTS: Mapping[Layout, str] = {
    "yolov5": "1 x boxes x (5 + classes)",
    "yolov8": "1 x (4 + classes) x boxes",
    "yolov10": "1 x boxes x 6",
}
ROUNDING = 1e-3  # by which a score may leave 0..1
ROUNDING_PX = 1.0  # by which a side may be below 0: corners in half precision are that coarse
SHARES = 2.0  # px; if no box reaches farther, boxes are given as shares of the picture
STRIDES = (4, 8, 16, 32, 64)  # px; side of the cells of a network's levels, of which each uses three or more that follow each other
ANCHORS = 3  # boxes a cell of YOLOv5 and YOLOv7; others have one
NEAR = 1 / 8  # of the picture's side; if no box of any cell reaches farther, boxes are offsets from their cells
MOST_CLASSES = 10_000  # of a network


def one_a_cell(n_boxes: float, input_px: tuple[int, int]) -> bool:
    """Whether a network gives a box for each cell of three or more levels of its picture."""
    cells = [(input_px[0] // stride) * (input_px[1] // stride) for stride in STRIDES]
    return n_boxes in {sum(cells[first:last]) for first in range(len(cells)) for last in range(first + 3, len(cells) + 1)}


def read(out: Tensor, layout: Layout, input_px: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Boxes `[n, 4]` in px of the network's picture (left, top, right, bottom) and scores `[n, C]` in 0..1 of all its classes.

    out: the network's output. input_px: width and height of its picture. Boxes that are not finite are dropped. Raises ValueError that says
    what was found if the output does not have the layout.
    """
    if out.ndim != 3 or len(out) != 1:
        raise ValueError("there must be three dimensions, the first of 1")
    rows = out[0].T if layout == "yolov8" else out[0]
    first = {"yolov8": 4, "yolov5": 5, "yolov10": 5}[layout]
    if rows.shape[1] <= first or (layout == "yolov10" and rows.shape[1] != 6):
        raise ValueError(f"each box has {rows.shape[1]} numbers")
    finite = rows[rows.isfinite().all(1)]
    if len(rows) and not len(finite):
        raise ValueError("no box has finite numbers only")
    boxes, rest = finite[:, :4], finite[:, first:]
    if layout == "yolov10":
        scores = _by_class(finite[:, 4], finite[:, 5])
    else:
        in_order = bool((boxes[:, 2:] >= boxes[:, :2]).all())  # as corners are, but not middles and sides
        if layout == "yolov5" and rest.shape[1] == 1 and len(rest) and _whole(rest) and in_order:
            raise ValueError("the sixth number of each box is whole, as the classes of yolov10 are")
        scores = rest * finite[:, 4:5] if layout == "yolov5" else rest
        middle, half = boxes[:, :2], boxes[:, 2:] / 2
        boxes = torch.cat([middle - half, middle + half], 1)
    if len(finite):
        _plausible(boxes, scores)
        dense = layout != "yolov10" and any(one_a_cell(len(rows) / each, input_px) for each in (1, ANCHORS))
        if dense and (farthest := float(boxes.max())) <= NEAR * min(input_px):
            raise ValueError(f"the boxes of all cells reach to {farthest:.3g} px at most, so they seem to be offsets that are not decoded")
    return boxes, scores.clamp(0, 1)


def _plausible(boxes: Tensor, scores: Tensor) -> None:
    low, high = (float(each) for each in scores.aminmax())
    if low < -ROUNDING or high > 1 + ROUNDING:
        raise ValueError(f"scores reach from {low:.3g} to {high:.3g} and not within 0..1")
    if (thinnest := float((boxes[:, 2:] - boxes[:, :2]).min())) < -ROUNDING_PX:
        raise ValueError(f"boxes have sides down to {thinnest:.3g} px")
    if 0 < (farthest := float(boxes.max())) <= SHARES:
        raise ValueError(f"boxes reach to {farthest:.3g} at most, so they seem to be shares of the picture and not px")


def _by_class(scores: Tensor, numbers: Tensor) -> Tensor:
    """Scores `[n, C]` of boxes of one class each, from those scores and the classes' numbers `[n]`."""
    if len(numbers) and not (_whole(numbers) and numbers.min() >= 0 and numbers.max() < MOST_CLASSES):
        raise ValueError("the sixth number of each box is not a class number")
    return scores[:, None] * one_hot(numbers.long(), int(max(numbers.tolist(), default=0)) + 1)


def _whole(numbers: Tensor) -> bool:
    return bool((numbers == numbers.round()).all())
