"""User-provided networks: any ONNX file with the output layout of a YOLO family, run by OpenCV on the CPU."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import one_hot

from luxloop.perception.detection.detector import COCO, COCO_CLASSES, Detections, Layout, OnnxParams, best_detections, encode
from luxloop.perception.detection.onnx_file import error_text, open_network, size_text
from luxloop.world.errors import LuxloopError
from luxloop.world.traffic.tracked import Category

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
    """Whether n_boxes is the number of cells of three or more successive levels of a picture."""
    cells = [(input_px[0] // stride) * (input_px[1] // stride) for stride in STRIDES]
    return n_boxes in {sum(cells[first:last]) for first in range(len(cells)) for last in range(first + 3, len(cells) + 1)}


def read(out: Tensor, layout: Layout, input_px: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Boxes `[n, 4]` in px of the network's picture (left, top, right, bottom) and scores `[n, C]` in 0..1 of all its classes.

    out: the network's output. input_px: width and height of its picture. Boxes that are not finite are dropped. Raises ValueError with the
    actual shape if the output does not have the layout.
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
    """Scores `[n, C]` of boxes of one class each, from the scores `[n]` and the class numbers `[n]`."""
    if len(numbers) and not (_whole(numbers) and numbers.min() >= 0 and numbers.max() < MOST_CLASSES):
        raise ValueError("the sixth number of each box is not a class number")
    return scores[:, None] * one_hot(numbers.long(), int(max(numbers.tolist(), default=0)) + 1)


def _whole(numbers: Tensor) -> bool:
    return bool((numbers == numbers.round()).all())


GREY = 114  # of the border around a fitted frame, as in training


class OnnxDetector:
    """See `Detector`. A class's score is the largest of the network's classes that map to it. Boxes that are not finite are dropped."""

    def __init__(self, params: OnnxParams) -> None:
        """Open the file and run it once, on a picture that brightens to the right.

        Raises LuxloopError as `onnx_file.open_network`, and if the output does not fit the parameters.
        """
        self.params = params
        self.meaning = params.classes or COCO
        self.classes: tuple[Category, ...] = tuple(dict.fromkeys(self.meaning.values()))
        self._net = open_network(params)
        columns, rows = params.input_px
        out = self._run(encode(torch.linspace(0, 1, columns).expand(rows, columns), params.gamma))
        self._check_classes(out, self._read(out)[1].shape[1])
        one = params.layout == "yolov5" and one_a_cell(out.shape[1], params.input_px) and bool((out[0, :, 4] != 1).any())
        if params.white is None and one:
            raise LuxloopError(
                f"detector.white: {params.file} gives one box a cell, as YOLOX does, which takes pictures of 0..255; set detector.white "
                "= 255 for YOLOX, 1 for networks that take 0..1"
            )

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """See `Detector`. Raises LuxloopError if the output does not fit the parameters."""
        return [self._found(frame) for frame in frames]

    def _found(self, frame: Tensor) -> Detections:
        params, (height, width) = self.params, frame.shape
        columns, rows = params.input_px
        scale = min(columns / width, rows / height)
        size = round(width * scale), round(height * scale)
        x, y = (columns - size[0]) // 2, (rows - size[1]) // 2
        picture = np.full((rows, columns), GREY, np.uint8)
        picture[y : y + size[1], x : x + size[0]] = cv2.resize(encode(frame, params.gamma), size, interpolation=cv2.INTER_AREA)
        boxes, scores = self._read(self._run(picture))
        scores = self._ours(scores)
        boxes = (boxes - torch.tensor([x, y, x, y])) / scale
        boxes = torch.minimum(boxes.clamp(min=0), torch.tensor([width, height, width, height]).float())
        return best_detections(boxes, scores, params.threshold, params.overlap, frame.device)

    def _run(self, picture: np.ndarray) -> Tensor:
        """Output of the network for a picture `[rows, columns]` uint8."""
        blob = np.repeat(picture[None, None].astype(np.float32) * ((self.params.white or 1) / 255), self.params.channels, 1)
        try:
            self._net.setInput(blob)
            out = np.asarray(self._net.forward())
        except cv2.error as error:
            raise LuxloopError(
                f"detector.file: {self.params.file}: OpenCV cannot run it on {size_text(blob.shape)} numbers ({error_text(error)}); "
                "export it for detector.input_px and detector.channels, or correct these"
            ) from error
        return torch.from_numpy(out.copy())

    def _ours(self, scores: Tensor) -> Tensor:
        """Scores `[n, C]` of luxloop's classes from scores of the network's classes."""
        scores = torch.nn.functional.pad(scores, (0, max(max(self.meaning) + 1 - scores.shape[1], 0)))
        numbers = [[number for number, each in self.meaning.items() if each == category] for category in self.classes]
        return torch.stack([scores[:, each].amax(1) for each in numbers], 1)

    def _read(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """`read` for the network's layout. Raises LuxloopError that names the output and a fitting layout."""
        layout = self.params.layout
        try:
            return read(out, layout, self.params.input_px)
        except ValueError as found:
            forms = "; ".join(f"{name}: {form}" for name, form in LAYOUTS.items())
            remedy = ", or ".join(self._others(out)) or f"export it with boxes in px and scores of 0..1 ({forms})"
            raise LuxloopError(f"detector.layout: {self._gives(out)}, which cannot be {layout}: {found}; {remedy}") from found

    def _others(self, out: Tensor) -> list[str]:
        """Remedies for other readings of the output: another layout, or a transposed yolov8."""

        def fits(out: Tensor, layout: Layout) -> bool:
            try:
                return self._wrong_classes(layout, read(out, layout, self.params.input_px)[1].shape[1]) is None
            except ValueError:
                return False

        found = [f'set detector.layout = "{layout}"' for layout in LAYOUTS if layout != self.params.layout and fits(out, layout)]
        if out.ndim == 3 and fits(turned := out.transpose(1, 2), "yolov8"):
            found.append(f'export it as {size_text(turned.shape)} and set detector.layout = "yolov8" where its boxes have no objectness')
        return found

    def _wrong_classes(self, layout: Layout, number: int) -> str | None:
        """Why the number of classes does not fit, or None; the shape of yolov10 does not contain the number."""
        if layout == "yolov10":
            return None
        if self.params.classes is None and number != COCO_CLASSES:
            return f"and not the {COCO_CLASSES} of COCO; set detector.classes"
        if (largest := max(self.meaning)) >= number:
            return f"counted from 0, so there is no {largest}; correct detector.classes"
        return None

    def _check_classes(self, out: Tensor, number: int) -> None:
        layout = self.params.layout
        if wrong := self._wrong_classes(layout, number):
            others = "".join(f", or {each}" for each in self._others(out))
            raise LuxloopError(f"detector.classes: {self._gives(out)}, {number} classes as {layout}, {wrong}{others}")

    def _gives(self, out: Tensor) -> str:
        return f"{self.params.file} gives {size_text(out.shape)} numbers"
