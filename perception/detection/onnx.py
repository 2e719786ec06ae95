"""User-provided networks: any ONNX file with the output layout of a YOLO family, run by OpenCV on the CPU."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.perception.detection.coded import encode
from luxloop.perception.detection.onnx_file import by, opened, said
from luxloop.perception.detection.params import COCO, COCO_CLASSES, OnnxParams
from luxloop.perception.detection.protocol import Detections
from luxloop.perception.detection.suppression import suppress
from luxloop.perception.detection.yolo import LAYOUTS, Layout, one_a_cell, read
from luxloop.world.errors import LuxloopError
from luxloop.world.traffic.tracked import Category

GREY = 114  # around a frame that is fitted in, as in training


class OnnxDetector:
    """See `Detector`. A class's score is the largest of the network's classes that map to it. Boxes that are not finite are dropped."""

    def __init__(self, params: OnnxParams) -> None:
        """Open the file and run it once, on a picture that brightens to the right.

        Raises LuxloopError as `onnx_file.opened` does, and if the output is not what the parameters say.
        """
        self.params = params
        self.meaning = params.classes or COCO
        self.classes: tuple[Category, ...] = tuple(dict.fromkeys(self.meaning.values()))
        self._net = opened(params)
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
        """See `Detector`. Raises LuxloopError if the output is not what the parameters say (see `yolo.read`)."""
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
        best = scores.amax(1) if len(scores) else scores.new_zeros(0)
        order = best.argsort(descending=True)
        order = order[best[order] >= params.threshold]
        boxes, scores = boxes[order].to(frame.device), scores[order].to(frame.device)
        kept = ~suppress(boxes, params.overlap) if len(boxes) else slice(0)
        return Detections(boxes[kept], scores[kept])

    def _run(self, picture: np.ndarray) -> Tensor:
        """Output of the network for a picture `[rows, columns]` uint8."""
        blob = np.repeat(picture[None, None].astype(np.float32) * ((self.params.white or 1) / 255), self.params.channels, 1)
        try:
            self._net.setInput(blob)
            out = np.asarray(self._net.forward())
        except cv2.error as error:
            raise LuxloopError(
                f"detector.file: {self.params.file}: OpenCV cannot run it on {by(blob.shape)} numbers ({said(error)}); "
                "export it for detector.input_px and detector.channels, or correct these"
            ) from error
        return torch.from_numpy(out.copy())

    def _ours(self, scores: Tensor) -> Tensor:
        """Scores `[n, C]` of luxloop's classes from those of the network's classes."""
        scores = torch.nn.functional.pad(scores, (0, max(max(self.meaning) + 1 - scores.shape[1], 0)))
        numbers = [[number for number, each in self.meaning.items() if each == category] for category in self.classes]
        return torch.stack([scores[:, each].amax(1) for each in numbers], 1)

    def _read(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """As `yolo.read`. Raises LuxloopError that names the output and the layout that fits."""
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
            found.append(f'export it as {by(turned.shape)} and set detector.layout = "yolov8" where its boxes have no objectness')
        return found

    def _wrong_classes(self, layout: Layout, number: int) -> str | None:
        """What speaks against that number of classes; those of yolov10 are not known before all are seen."""
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
        return f"{self.params.file} gives {by(out.shape)} numbers"
