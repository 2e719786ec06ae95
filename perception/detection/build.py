"""The detectors that a scenario can name."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, cast, get_args

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.perception.detection.detector import (
    Detections,
    Detector,
    HogParams,
    NetworkParams,
    OnnxParams,
    OwnDetector,
    RunParams,
    best_detections,
    encode,
)
from luxloop.perception.detection.network import NetworkDetector, load
from luxloop.perception.detection.onnx import OnnxDetector
from luxloop.perception.detection.onnx_layouts import SHARES
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.traffic.tracked import Category

KEY = "detector.kind"
METHODS = ("detect",)
GIVES = "give one Detections a frame: finite tensors of boxes [n, 4] and of scores [n, classes]"
WEIGHTS = "weights/night.pt"  # shipped, with their report beside them


def detector(params: RunParams, device: torch.device) -> Detector:
    """The detector of a scenario. Raises LuxloopError if its file is missing or broken, or a user-defined one cannot be made."""
    match params:
        case NetworkParams():
            return network_detector(params, device)
        case HogParams():
            return HogDetector(params)
        case OnnxParams():
            return OnnxDetector(params)
        case OwnDetector():
            return own_detector(plugin.load(params.kind, KEY, METHODS), params, device)


def own_detector(made_by: type, params: OwnDetector, device: torch.device) -> "CheckedDetector":
    """A user-defined detector of a class with the methods. Raises LuxloopError if it cannot be made or its classes are unknown."""
    own = plugin.construct(made_by, params.kind, KEY, {"device": device}, params.options)
    classes, known = getattr(own, "classes", None), get_args(Category)
    if not isinstance(classes, tuple) or not classes or any(each not in known for each in classes):
        given = "no classes" if classes is None else f"classes = {classes!r}"
        raise LuxloopError(f"{KEY}: {params.kind}: has {given}; it needs a tuple of some of {', '.join(known)}")
    return CheckedDetector(own)


def network_detector(params: NetworkParams, device: torch.device) -> NetworkDetector:
    """luxloop's own detector with shipped or other weights. Raises LuxloopError if the file holds none."""
    if params.weights is not None:
        with locate("detector.weights"):
            network, classes = load(Path(params.weights), device)
    else:
        with as_file(files("luxloop.perception.detection") / WEIGHTS) as file:
            network, classes = load(file, device)
    return NetworkDetector(network, classes, params.threshold, params.overlap)


@dataclass(frozen=True)
class CheckedDetector:
    """A user-defined detector whose detections are checked."""

    own: plugin.Guard

    @property
    def classes(self) -> tuple[Category, ...]:
        return cast(tuple[Category, ...], self.own.classes)

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """Raises LuxloopError if it fails or does not return valid detections."""
        return self.check(self.own.detect(frames), frames)

    def check(self, found: Any, frames: Tensor) -> Sequence[Detections]:
        """The detections in frames `[B, height, width]`. Raises LuxloopError where they are invalid."""
        where, classes = f"{KEY}: {self.own.name}: detect", len(self.classes)
        if not isinstance(found, list | tuple):
            raise LuxloopError(f"{where} gives a {type(found).__name__}; give a list with one luxloop.Detections a frame")
        with plugin.running(self.own.name, KEY, f"reading what detect gives, which must {GIVES},"):
            shapes = [(tuple(each.boxes.shape), tuple(each.scores.shape)) for each in found]
            finite = all(bool(each.boxes.isfinite().all() and each.scores.isfinite().all()) for each in found)
        if len(shapes) != len(frames):
            raise LuxloopError(f"{where} gives {len(shapes)} for {len(frames)} frames; it must {GIVES}")
        for boxes, scores in shapes:
            count = next(iter(boxes), 0)
            if (boxes, scores) != ((count, 4), (count, classes)) or not finite:
                what = f"boxes {list(boxes)} and scores {list(scores)}" + ("" if finite else ", some of which are not finite")
                raise LuxloopError(f"{where} gives {what}; with {classes} classes it must {GIVES}")
        with locate(where):
            for each in found:
                _check_ranges(each, *frames.shape[1:])
        return found


def _check_ranges(found: Detections, height: int, width: int) -> None:
    """Raises LuxloopError for scores outside 0..1, and for boxes that are not boxes in a frame of height x width px."""
    if not len(found):
        return
    (low, high), boxes = (float(each) for each in found.scores.aminmax()), found.boxes
    if low < 0 or high > 1:
        raise LuxloopError(f"gives scores from {low:.3g} to {high:.3g}; give 0..1: of logits the sigmoid, of percent a hundredth")
    if (thinnest := float((boxes[:, 2:] - boxes[:, :2]).min())) <= 0:
        raise LuxloopError(
            f"gives boxes with sides down to {thinnest:.3g} px; give left, top, right, bottom, not the middle or width and height"
        )
    if (farthest := float(boxes.max())) <= SHARES:
        raise LuxloopError(
            f"gives boxes that reach to {farthest:.3g} px at most, so they seem to be shares of the frame; multiply them by its width and "
            f"height, here {width} and {height} px"
        )
    u, v = ((boxes[:, :2] + boxes[:, 2:]) / 2).T
    if bool(((u < 0) | (u > width) | (v < 0) | (v > height)).any()):
        raise LuxloopError(
            f"gives boxes whose middle is outside of the frame of {width} x {height} px; give px of the frame, not of a picture of another "
            "size, columns first: left, top, right, bottom"
        )


SHRINK = (0.55, 0.75)  # width and height of a person over those of HOG's window of 64 x 128 px


class HogDetector:
    """See `Detector`. A score is the logistic function of the distance to the classifier's plane."""

    classes: tuple[Category, ...] = ("pedestrian",)

    def __init__(self, params: HogParams) -> None:
        self.params = params
        self._hog = cv2.HOGDescriptor()
        self._hog.setSVMDetector(np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector()))

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """See `Detector`."""
        return [self._found(frame) for frame in frames]

    def _found(self, frame: Tensor) -> Detections:
        params = self.params
        picture = cv2.resize(encode(frame, params.gamma), None, fx=params.magnify, fy=params.magnify, interpolation=cv2.INTER_LINEAR)
        # OpenCV reads beyond images that are smaller than its window
        width, height = self._hog.winSize
        below, right = max(height - picture.shape[0], 0), max(width - picture.shape[1], 0)
        picture = cv2.copyMakeBorder(picture, 0, below, 0, right, cv2.BORDER_REPLICATE)
        margin = math.log(params.threshold / (1 - params.threshold)) / params.slope
        windows, margins = self._hog.detectMultiScale(picture, hitThreshold=margin, winStride=(8, 8), scale=1.05, groupThreshold=0)
        corner, size = torch.from_numpy(np.reshape(windows, (-1, 4)).astype(np.float32) / params.magnify).split(2, 1)
        half = size * torch.tensor(SHRINK) / 2
        boxes = torch.cat([corner + size / 2 - half, corner + size / 2 + half], 1)
        scores = torch.sigmoid(params.slope * torch.from_numpy(np.ravel(margins).astype(np.float32)))
        return best_detections(boxes, scores[:, None], 0.0, params.overlap, frame.device)
