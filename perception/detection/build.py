"""The detector that a scenario names."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, cast, get_args

import torch
from torch import Tensor

from perception.detection.hog import HogDetector
from perception.detection.network import NetworkDetector, load
from perception.detection.onnx import OnnxDetector
from perception.detection.params import HogParams, NetworkParams, OnnxParams, OwnDetector, RunParams
from perception.detection.protocol import Detections, Detector
from world import plugin
from world.errors import LuxloopError, located
from world.traffic.tracked import Category

KEY = "detector.kind"
METHODS = ("detect",)
GIVES = "give one Detections a frame: finite tensors of boxes [n, 4] and of scores [n, classes]"
WEIGHTS = "weights/night.pt"  # shipped, with their report beside them


def detector(params: RunParams, device: torch.device) -> Detector:
    """Raises LuxloopError where its file is missing or broken, or one of the user's own cannot be made."""
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
    """One of the user's own, of a class that has the methods. Raises LuxloopError where it cannot be made, or its classes are unknown."""
    own = plugin.made(made_by, params.kind, KEY, {"device": device}, params.options)
    classes, known = getattr(own, "classes", None), get_args(Category)
    if not isinstance(classes, tuple) or not classes or any(each not in known for each in classes):
        given = "no classes" if classes is None else f"classes = {classes!r}"
        raise LuxloopError(f"{KEY}: {params.kind}: has {given}; it needs a tuple of some of {', '.join(known)}")
    return CheckedDetector(own, params.kind)


def network_detector(params: NetworkParams, device: torch.device) -> NetworkDetector:
    """luxloop's own, with the weights shipped or others. Raises LuxloopError where these are none."""
    if params.weights is not None:
        with located("detector.weights"):
            network, classes = load(Path(params.weights), device)
    else:
        with as_file(files("perception.detection") / WEIGHTS) as file:
            network, classes = load(file, device)
    return NetworkDetector(network, classes, params.threshold, params.overlap)


@dataclass(frozen=True)
class CheckedDetector:
    """The user's own detector, whose detections are checked. kind: its name in the scenario."""

    own: plugin.Guarded
    kind: plugin.Name

    @property
    def classes(self) -> tuple[Category, ...]:
        return cast(tuple[Category, ...], self.own.classes)

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """Raises LuxloopError where it fails, or gives something else than detections."""
        return self.checked(self.own.detect(frames), len(frames))

    def checked(self, found: Any, frames: int) -> Sequence[Detections]:
        """The detections of n frames. Raises LuxloopError where they are invalid."""
        with plugin.running(self.kind, KEY, f"reading what detect gives, which must {GIVES},"):
            shapes = [(tuple(each.boxes.shape), tuple(each.scores.shape)) for each in found]
            finite = all(bool(each.boxes.isfinite().all() and each.scores.isfinite().all()) for each in found)
        where, classes = f"{KEY}: {self.kind}: detect", len(self.classes)
        if len(shapes) != frames:
            raise LuxloopError(f"{where} gives {len(shapes)} for {frames} frames; it must {GIVES}")
        for boxes, scores in shapes:
            count = next(iter(boxes), 0)
            if (boxes, scores) != ((count, 4), (count, classes)) or not finite:
                what = f"boxes {list(boxes)} and scores {list(scores)}" + ("" if finite else ", some of which are not finite")
                raise LuxloopError(f"{where} gives {what}; with {classes} classes it must {GIVES}")
        return cast(Sequence[Detections], found)
