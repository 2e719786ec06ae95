"""Object detectors: protocol, parameters in a scenario, and common functions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Protocol, Self

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.world.params import NotNegative, Params, PositiveShare, Share
from luxloop.world.plugin import KnownOrOwn, OwnPart
from luxloop.world.traffic.tracked import Category

Layout = Literal["yolov5", "yolov8", "yolov10", "yolox", "rows", "rtdetr", "detr", "scored", "listed"]


@dataclass(frozen=True)
class Detections:
    """Detections in one frame; detectors order them by descending score, trackers accept any order.

    boxes: `[n, 4]` px, left, top, right, bottom, including hidden parts. scores: `[n, C]` in 0..1, one for each class of the detector.
    """

    boxes: Tensor
    scores: Tensor

    def __len__(self) -> int:
        return len(self.boxes)


class Detector(Protocol):
    """Detects objects in grey frames, each frame by itself."""

    @property
    def classes(self) -> tuple[Category, ...]:
        """The classes of its scores, in order."""
        ...

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """One Detections for each of the frames `[B, height, width]`, digital numbers as shares 0..1 of the largest."""
        ...


def encode(frame: Tensor, gamma: float) -> np.ndarray:
    """Levels 0..255 `[height, width]` uint8 of a frame `[height, width]` in 0..1."""
    picture: np.ndarray = frame.float().clamp(0, 1).pow(1 / gamma).mul(255).round().byte().cpu().numpy()
    return picture


SAME = 0.3  # least overlap of a detected box with the object's box


def overlaps(boxes: Tensor, others: Tensor) -> Tensor:
    """Intersection over union `[..., n, m]` of boxes `[..., n, 4]` and others `[..., m, 4]`: left, top, right, bottom; 0 of empty ones."""
    low = torch.maximum(boxes[..., :, None, :2], others[..., None, :, :2])
    high = torch.minimum(boxes[..., :, None, 2:], others[..., None, :, 2:])
    both = (high - low).clamp(min=0).prod(-1)
    areas = [(each[..., 2:] - each[..., :2]).clamp(min=0).prod(-1) for each in (boxes, others)]
    return both / (areas[0][..., :, None] + areas[1][..., None, :] - both).clamp(min=1e-9)


def suppress(boxes: Tensor, overlap: float) -> Tensor:
    """Boxes `[..., n, 4]`, by descending score, that overlap one of higher score with an IoU above `overlap`: `[..., n]` bool (Fast NMS,
    Bolya 2019).

    Suppressed boxes suppress others as well, so that all boxes are compared at once.
    """
    return overlaps(boxes, boxes).triu(1).amax(-2) > overlap


def best_detections(boxes: Tensor, scores: Tensor, threshold: float, overlap: float, device: torch.device) -> Detections:
    """Detections by descending best score, from the threshold on, without suppressed boxes. boxes: `[n, 4]`; scores: `[n, C]`."""
    best = scores.amax(1)
    order = best.argsort(descending=True)
    order = order[best[order] >= threshold]
    boxes, scores = boxes[order].to(device), scores[order].to(device)
    kept = ~suppress(boxes, overlap) if len(boxes) else slice(0)
    return Detections(boxes[kept], scores[kept])


# luxloop's classes by COCO's names, which most public networks have; other classes are dropped.
ANIMALS = ("bird", "cat", "dog", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe")
COCO_NAMES: dict[str, Category] = {
    "person": "pedestrian",
    "pedestrian": "pedestrian",
    "bicycle": "cyclist",
    "cyclist": "cyclist",
    "rider": "cyclist",
    "car": "car",
    "motorcycle": "motorcycle",
    "motorbike": "motorcycle",
    "bus": "truck",
    "truck": "truck",
    **dict.fromkeys((*ANIMALS, "animal"), "animal"),
}
COCO: dict[int, Category] = {
    0: "pedestrian",
    1: "cyclist",
    2: "car",
    3: "motorcycle",
    5: "truck",
    7: "truck",
    **dict.fromkeys(range(14, 24), "animal"),
}  # by the numbers of 80 classes
COCO91: dict[int, Category] = {
    1: "pedestrian",
    2: "cyclist",
    3: "car",
    4: "motorcycle",
    6: "truck",
    8: "truck",
    **dict.fromkeys(range(16, 26), "animal"),
}  # by COCO's own numbers, which leave gaps
MOST_PX = 8192
Side = Annotated[int, Field(ge=1, le=MOST_PX)]  # px
ClassName = Annotated[Annotated[int, Field(ge=0, lt=1_000_000)] | str, Field(union_mode="left_to_right")]


class FoundParams(Params):
    """Common parameters of the detectors that luxloop runs itself."""

    threshold: float = Field(0.1, gt=0, lt=1, description="least score of reported detections")
    overlap: PositiveShare = Field(0.5, description="IoU above which the box of lower score is suppressed")


class NetworkParams(FoundParams):
    """luxloop's own network, trained on well-lit scenes."""

    kind: Literal["network"] = "network"
    weights: str | None = Field(None, min_length=1, description="weights file from `luxloop train-detector`; left out: the shipped weights")


class CodedParams(FoundParams):
    """Common parameters of detectors that take 8-bit gamma-coded images."""

    gamma: float = Field(2.2, ge=1, le=3, description="frames are raised to the power 1/gamma before detection; 1: unchanged")


class HogParams(CodedParams):
    """OpenCV's detector of upright people, by histograms of gradients."""

    kind: Literal["hog"] = "hog"
    magnify: float = Field(2.0, ge=0.5, le=8, description="enlargement of frames; HOG finds people of at least 96 px in the enlarged frame")
    slope: float = Field(
        2.0, gt=0, le=20, description="slope of the logistic curve from the SVM's margin to a score; the margin is 0 at the detection limit"
    )


Mean = Annotated[float, Field(ge=-10, le=10)]
Deviation = Annotated[float, Field(gt=0, le=10)]


class OnnxParams(CodedParams):
    """A user-provided network as an ONNX file, run by onnxruntime, or by OpenCV without it."""

    kind: Literal["onnx"] = "onnx"
    file: str = Field(min_length=1, examples=["detector.onnx"], description="ONNX file of the network")
    layout: Layout | None = Field(None, description="layout of its outputs (see docs/detectors.md); left out: found from its outputs")
    input_px: tuple[Side, Side] | None = Field(
        None, description="width and height of its input, where the file leaves them open; left out: the file's, or 640 x 640"
    )
    fit: Literal["letterbox", "stretch", "tiles"] = Field(
        "letterbox",
        description="fits frames in: whole with a grey border, stretched, or in tiles of their height that overlap",
    )
    white: Literal[1, 255] | None = Field(None, description="number of white in its input; left out: 255 for bytes and yolox, else 1")
    mean: tuple[Mean, Mean, Mean] | Mean | None = Field(None, description="mean subtracted from its input, as shares of white; left out: 0")
    std: tuple[Deviation, Deviation, Deviation] | Deviation | None = Field(
        None, description="deviation by which that is divided, as shares of white; left out: 1"
    )
    classes: Literal["coco", "coco91"] | dict[ClassName, Category] | None = Field(
        None,
        description="luxloop's class for each of its classes, by number or by the name in the file; others are ignored; coco: COCO's 80 "
        "classes; coco91: COCO's own numbers; left out: by the names in the file, else COCO's",
    )

    @model_validator(mode="after")
    def _some_class(self) -> Self:
        if self.classes == {}:
            raise ValueError("classes: names no class; leave it out for COCO's")
        return self


class OwnDetector(OwnPart):
    """A user-defined detector `Name(device, **options)`."""


class TruthParams(Params):
    """Ground truth: every object of the scene, however dark. Classes: of all objects, parked cars included."""

    kind: Literal["truth"] = "truth"
    least_height_px: NotNegative = Field(12.0, description="least height of a detected object")
    least_visible: Share = Field(0.3, description="least visible share of a detected object")


RunParams = NetworkParams | HogParams | OnnxParams | OwnDetector
AnyParams = NetworkParams | HogParams | OnnxParams | TruthParams | OwnDetector
DetectorParams = Annotated[AnyParams, KnownOrOwn("kind")]
