"""Networks of the user's own: any ONNX file that gives what one of the YOLO families gives, run by OpenCV on the CPU."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from perception.detection.coded import coded
from perception.detection.params import COCO, OnnxParams
from perception.detection.protocol import Detections
from perception.detection.suppression import suppressed
from world.errors import LuxloopError
from world.tracked import Category

GREY = 114  # around a frame that is fitted in, as in training


class OnnxDetector:
    """See `Detector`. A class's score is the largest of those numbers that mean it. Boxes whose numbers are not finite are left out."""

    def __init__(self, params: OnnxParams) -> None:
        """Raises LuxloopError where the file is missing, or none that OpenCV can run."""
        if not Path(params.file).is_file():
            raise LuxloopError(f"detector.file: {params.file}: there is no such file; check the path")
        self.params = params
        self.meaning = params.classes or COCO
        self.classes: tuple[Category, ...] = tuple(dict.fromkeys(self.meaning.values()))
        try:
            # the classic engine gives outputs in another order
            self._net = cv2.dnn.readNetFromONNX(params.file, cv2.dnn.ENGINE_NEW)
        except cv2.error as error:
            raise LuxloopError(f"detector.file: {params.file}: OpenCV cannot read it ({_said(error)}); export it anew") from error

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """See `Detector`. Raises LuxloopError where the network takes or gives something else than the parameters say."""
        return [self._found(frame) for frame in frames]

    def _found(self, frame: Tensor) -> Detections:
        params, (height, width) = self.params, frame.shape
        columns, rows = params.input_px
        scale = min(columns / width, rows / height)
        size = round(width * scale), round(height * scale)
        x, y = (columns - size[0]) // 2, (rows - size[1]) // 2
        picture = np.full((rows, columns), GREY, np.uint8)
        picture[y : y + size[1], x : x + size[0]] = cv2.resize(coded(frame, params.gamma), size, interpolation=cv2.INTER_AREA)
        boxes, scores = self._boxes(self._run(np.repeat(picture[None, None].astype(np.float32) / 255, params.channels, 1)))
        finite = boxes.isfinite().all(1) & scores.isfinite().all(1)
        boxes, scores = boxes[finite], scores[finite]
        boxes = (boxes - torch.tensor([x, y, x, y])) / scale
        boxes = torch.minimum(boxes.clamp(min=0), torch.tensor([width, height, width, height]).float())
        best = scores.amax(1) if len(scores) else scores.new_zeros(0)
        order = best.argsort(descending=True)
        order = order[best[order] >= params.threshold]
        boxes, scores = boxes[order].to(frame.device), scores[order].to(frame.device)
        kept = ~suppressed(boxes, params.overlap) if len(boxes) else slice(0)
        return Detections(boxes[kept], scores[kept])

    def _run(self, blob: np.ndarray) -> Tensor:
        params = self.params
        try:
            self._net.setInput(blob)
            out = np.asarray(self._net.forward())
        except cv2.error as error:
            asked = f"{params.channels} x {params.input_px[1]} x {params.input_px[0]}"
            raise LuxloopError(
                f"detector.file: {params.file}: OpenCV cannot run it on {asked} numbers ({_said(error)}); "
                "set detector.input_px and detector.channels"
            ) from error
        if out.ndim != 3 or len(out) != 1:
            raise self._other_layout(out)
        return torch.from_numpy(out[0].copy())

    def _boxes(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """Boxes `[n, 4]` in px of what it saw, and scores `[n, C]` of our classes."""
        layout = self.params.layout
        rows = out.T if layout == "yolov8" else out
        first = {"yolov8": 4, "yolov5": 5, "yolov10": 6}[layout]
        if rows.shape[1] < first or (layout == "yolov10" and rows.shape[1] != 6):
            raise self._other_layout(out[None].numpy())
        if layout == "yolov10":
            boxes, found, number = rows[:, :4], rows[:, 4], rows[:, 5].long()
            return boxes, torch.stack([found * sum(number == k for k in self._numbers(each)) for each in self.classes], 1)
        if (largest := max(self.meaning)) >= rows.shape[1] - first:
            raise LuxloopError(
                f"detector.classes: {self.params.file} has {rows.shape[1] - first} classes, counted from 0, so there is no {largest}; "
                "leave it out, or set detector.layout"
            )
        each_score = rows[:, first:] * (rows[:, 4:5] if layout == "yolov5" else 1)
        scores = torch.stack([each_score[:, self._numbers(each)].amax(1) for each in self.classes], 1)
        middle, half = rows[:, :2], rows[:, 2:4] / 2
        return torch.cat([middle - half, middle + half], 1), scores

    def _numbers(self, category: Category) -> list[int]:
        return [number for number, each in self.meaning.items() if each == category]

    def _other_layout(self, out: np.ndarray) -> LuxloopError:
        shape, layout = " x ".join(map(str, out.shape)), self.params.layout
        wanted = {"yolov5": "1 x boxes x (5 + classes)", "yolov8": "1 x (4 + classes) x boxes", "yolov10": "1 x boxes x 6"}[layout]
        return LuxloopError(f"detector.layout: {layout} gives {wanted} numbers, but {self.params.file} gives {shape}; set another layout")


def _said(error: cv2.error) -> str:
    return " ".join(str(error.err or error).split())
