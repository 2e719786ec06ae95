"""User-provided networks: any ONNX file whose outputs have a known layout, on the CPU."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.perception.detection.detector import COCO, COCO91, COCO_NAMES, Detections, Layout, OnnxParams, best_detections, encode
from luxloop.perception.detection.onnx_file import open_network, size_text
from luxloop.perception.detection.onnx_layouts import LAYOUTS, Form, Outputs, cells, fitting, read
from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.traffic.tracked import Category

GREY = 114  # of the border around a fitted frame, as in training
OVERLAP = 0.25  # least share that neighbouring tiles have in common
EDGE_PX = 2.0  # of the network's picture; a box so near to an inner side of a tile is cut there
OWN = "or write a detector of your own"
NUMBERINGS: Mapping[str, Mapping[int, Category]] = {"coco": COCO, "coco91": COCO91}
OF_DETR = 91  # classes by which its kin differs from RT-DETR, which has COCO's 80
COUNTS = {80: "coco", OF_DETR: "coco91"}  # classes of networks that do not name theirs
IMAGENET = "mean = [0.485, 0.456, 0.406] and detector.std = [0.229, 0.224, 0.225]"


@dataclass(frozen=True)
class Window:
    """Columns of a frame in the network's picture: x_picture = left_px + scale_x (x_frame - x), y_picture = top_px + scale_y y_frame."""

    x: int
    width: int
    scale: tuple[float, float]
    left_px: int
    top_px: int

    def into_frame(self, boxes: Tensor) -> Tensor:
        """Boxes `[n, 4]` px of the frame, from those of the picture."""
        border, origin = boxes.new_tensor([self.left_px, self.top_px] * 2), boxes.new_tensor([self.x, 0] * 2)
        return (boxes - border) / boxes.new_tensor(self.scale * 2) + origin


class OnnxDetector:
    """See `Detector`. A class's score is the largest of the network's classes that map to it. Boxes that are not finite are dropped."""

    def __init__(self, params: OnnxParams) -> None:
        """Open the file and run it once, on a picture that brightens to the right.

        Raises LuxloopError as `onnx_file.open_network`, and if the outputs do not fit the parameters.
        """
        self.params = params
        self.network = open_network(params)
        self.form = Form(self.network.picture.input_px, max(self.network.names, default=-1) + 1 or None)
        columns, rows = self.form.input_px
        white = params.white or (255 if self.network.picture.numbers == "uint8" else 1)
        outputs = self._run(encode(torch.linspace(0, 1, columns).expand(rows, columns), params.gamma), white)
        self.layout = params.layout or self._layout_of(outputs)
        count = self._read(outputs)[1].shape[1]
        self.meaning = self._meaning(outputs, count)
        self.classes: tuple[Category, ...] = tuple(dict.fromkeys(self.meaning.values()))
        self.white = 255 if self.layout == "yolox" and params.white is None else white
        if self.layout == "yolov5" and params.white is None and self._like_yolox(outputs):
            raise LuxloopError(
                f"detector.white: {params.file} gives one box a cell, as YOLOX does, which takes pictures of 0..255; set detector.white "
                "= 255 for YOLOX, 1 for networks that take 0..1"
            )
        if params.mean is None and (self.layout == "detr" or (self.layout, count) == ("rtdetr", OF_DETR)):
            raise LuxloopError(
                f"detector.mean: {params.file} is of the family of DETR, which takes normalised pictures; set "
                f"detector.{IMAGENET}, or 0 and 1 where the file does this itself"
            )

    def __str__(self) -> str:
        network, classes = self.network, ", ".join(f"{number}: {name}" for number, name in self.meaning.items())
        return f"layout {self.layout}, takes {network.picture} of 0..{self.white:g}, run by {network.library}; classes {classes}"

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """See `Detector`. Raises LuxloopError if the outputs do not fit the parameters."""
        return [self._found(frame) for frame in frames]

    def _found(self, frame: Tensor) -> Detections:
        params, picture = self.params, encode(frame, self.params.gamma)
        height, width = picture.shape
        found = [self._in_window(picture, window) for window in self._windows(width, height)]
        boxes, scores = (torch.cat(each) for each in zip(*found, strict=True))
        boxes = torch.minimum(boxes.clamp(min=0), torch.tensor([width, height, width, height]).float())
        return best_detections(boxes, scores, params.threshold, params.overlap, frame.device)

    def _windows(self, width: int, height: int) -> Iterator[Window]:
        """The windows of a frame of a size: itself, or tiles of its height that overlap."""
        columns, rows = self.form.input_px
        across = min(width, round(height * columns / rows)) if self.params.fit == "tiles" else width
        count = 1 + math.ceil((width - across) / (across * (1 - OVERLAP)))
        for x in np.linspace(0, width - across, count).round().astype(int).tolist():
            scale = columns / across, rows / height
            if self.params.fit != "stretch":
                scale = (min(scale),) * 2
            left, top = (columns - round(across * scale[0])) // 2, (rows - round(height * scale[1])) // 2
            yield Window(x, across, scale, left, top)

    def _in_window(self, picture: NDArray[np.uint8], window: Window) -> tuple[Tensor, Tensor]:
        """Boxes `[n, 4]` px of the frame and scores `[n, C]` of luxloop's classes in a window."""
        columns, rows = self.form.input_px
        size = round(window.width * window.scale[0]), round(len(picture) * window.scale[1])
        fitted = np.full((rows, columns), GREY, np.uint8)
        part = picture[:, window.x : window.x + window.width]
        place = np.s_[window.top_px : window.top_px + size[1], window.left_px : window.left_px + size[0]]
        fitted[place] = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        boxes, scores = self._read(self._run(fitted, self.white))
        cut = torch.zeros(len(boxes), dtype=torch.bool)
        narrow = boxes[:, 2] - boxes[:, 0] < OVERLAP * window.width * window.scale[0]  # so that a neighbour shows the whole
        if window.x > 0:
            cut |= narrow & (boxes[:, 0] < window.left_px + EDGE_PX)
        if window.x + window.width < picture.shape[1]:
            cut |= narrow & (boxes[:, 2] > window.left_px + size[0] - EDGE_PX)
        return window.into_frame(boxes[~cut]), self._ours(scores[~cut])

    def _run(self, picture: NDArray[np.uint8], white: float) -> Outputs:
        """Outputs of the network by name for a picture `[rows, columns]`."""
        channels = self.network.picture.channels
        mean, std = (
            np.broadcast_to(np.asarray(usual if given is None else given, np.float32), channels)[:, None, None]
            for given, usual in ((self.params.mean, 0), (self.params.std, 1))
        )
        return self.network.outputs((white * (picture[None] / 255 - mean) / std).astype(np.float32))

    def _ours(self, scores: Tensor) -> Tensor:
        """Scores `[n, C]` of luxloop's classes from scores of the network's classes."""
        scores = torch.nn.functional.pad(scores, (0, max(max(self.meaning) + 1 - scores.shape[1], 0)))
        numbers = [[number for number, each in self.meaning.items() if each == category] for category in self.classes]
        return torch.stack([scores[:, each].amax(1) for each in numbers], 1)

    def _read(self, outputs: Outputs) -> tuple[Tensor, Tensor]:
        """`read` for the network's layout. Raises LuxloopError that names the outputs and a fitting layout."""
        try:
            return read(outputs, self.layout, self.form)
        except ValueError as found:
            remedy = ", or ".join(self._others(outputs)) or f"export it in one of these forms ({_forms()}), {OWN}"
            raise LuxloopError(f"detector.layout: {self._gives(outputs)}, which cannot be {self.layout}: {found}; {remedy}") from found

    def _layout_of(self, outputs: Outputs) -> Layout:
        """The only layout that fits. Raises LuxloopError where none does, or several do."""
        found, nearly = fitting(outputs, self.form, self._count_fits)
        if len(found) == 1:
            return found[0]
        if found:
            raise LuxloopError(
                f"detector.layout: {self._gives(outputs)}, which may be {' or '.join(found)}; set detector.layout to what it is"
            )
        if counted := fitting(outputs, self.form, lambda name, count: True)[0]:
            return counted[0]  # its classes are refused
        reason = "; ".join(nearly) or _forms()
        raise LuxloopError(f"detector.layout: {self._gives(outputs)}, which is none of the known forms ({reason}); export it in one, {OWN}")

    def _others(self, outputs: Outputs) -> list[str]:
        """Remedies for other readings of the outputs: another layout, or a transposed yolov8."""
        others = [name for name in fitting(outputs, self.form, self._count_fits)[0] if name != self.layout]
        found = [f'set detector.layout = "{name}"' for name in others]
        turned = {name: each.transpose(1, 2) for name, each in outputs.items() if each.ndim == 3}
        if "yolov8" in fitting(turned, self.form, self._count_fits)[0]:
            size = size_text(tuple(next(iter(turned.values())).shape))
            found.append(f'export it as {size} and set detector.layout = "yolov8" where its boxes have no objectness')
        return found

    def _or_others(self, outputs: Outputs) -> str:
        return "".join(f", or {each}" for each in self._others(outputs))

    def _count_fits(self, layout: Layout, count: int) -> bool:
        """Whether a network can have this number of classes."""
        if not LAYOUTS[layout].counted:
            return True
        if self.form.classes is not None:
            return count == self.form.classes
        given = self.params.classes
        return count in COUNTS if given is None else count > (max(self._numbers(given)) if isinstance(given, dict) else min(COUNTS) - 1)

    def _numbers(self, given: Mapping[int | str, Category]) -> dict[int, Category]:
        """Categories by number of classes given by number or name."""
        known = {name: number for number, name in self.network.names.items()}
        for name in given.keys() - known.keys():
            if isinstance(name, str):
                remedy = did_you_mean(name, known) if known else "the file names no classes, so give their numbers"
                raise LuxloopError(f"detector.classes: {self.params.file} has no class {name!r}; {remedy}")
        return {number if isinstance(number, int) else known[number]: category for number, category in given.items()}

    def _meaning(self, outputs: Outputs, scores: int) -> dict[int, Category]:
        """Categories by the network's class numbers. Raises LuxloopError where they do not fit the network."""
        given, layout, where = self.params.classes, LAYOUTS[self.layout], "detector.classes: "
        count = scores if layout.counted else self.form.classes
        named = f"{where}{self._gives(outputs)}, {count} classes as {self.layout}"
        if isinstance(given, dict):
            found = self._numbers(given)
        elif given is not None:
            found = dict(NUMBERINGS[given])
        elif self.network.names:
            ours = {number: COCO_NAMES.get(name.lower()) for number, name in self.network.names.items()}
            found = {number: category for number, category in ours.items() if category is not None}
            if not found:
                raise LuxloopError(
                    f"{where}{self.params.file} has the classes {', '.join(self.network.names.values())[:200]}; set detector.classes"
                )
        elif not layout.counted:
            raise LuxloopError(
                f'{where}{self._gives(outputs)}, class numbers without names; set detector.classes = "coco" (a person is 0) or "coco91" '
                "(1), or a table of numbers"
            )
        elif count in COUNTS:
            found = dict(NUMBERINGS[COUNTS[count]])
        else:
            raise LuxloopError(
                f"{named}, and not the {' or '.join(map(str, COUNTS))} of COCO; set detector.classes{self._or_others(outputs)}"
            )
        if count is not None and (largest := max(found)) >= count:
            raise LuxloopError(f"{named}, counted from 0, so there is no {largest}; correct detector.classes{self._or_others(outputs)}")
        return found

    def _like_yolox(self, outputs: Outputs) -> bool:
        rows = next(each for each in outputs.values() if each.ndim == 3)[0]
        return cells(self.form.input_px, len(rows)) is not None and bool((rows[:, 4] != 1).any())

    def _gives(self, outputs: Outputs) -> str:
        sizes = ", ".join(
            f"{name} {size_text(tuple(each.shape))}" if len(outputs) > 1 else size_text(tuple(each.shape)) for name, each in outputs.items()
        )
        return f"{self.params.file} gives {sizes} numbers"


def _forms() -> str:
    return "; ".join(f"{name}: {family.form}" for name, family in LAYOUTS.items())
