"""The detector that a scenario names."""

from importlib.resources import as_file, files
from pathlib import Path
from typing import cast, get_args

import torch
from torch import Tensor

from perception.detection.hog import HogDetector
from perception.detection.network import NetworkDetector, load
from perception.detection.onnx import OnnxDetector
from perception.detection.params import HogParams, NetworkParams, OnnxParams, OwnDetector, RunParams
from perception.detection.protocol import Detections, Detector
from world import plugin
from world.errors import LuxloopError, located
from world.tracked import Category

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
            own = plugin.make(params.kind, "detector.kind", {"device": device}, params.options, ["detect"])
            classes, known = getattr(own, "classes", None), get_args(Category)
            if not isinstance(classes, tuple) or not classes or any(each not in known for each in classes):
                given = "no classes" if classes is None else f"classes = {classes!r}"
                raise LuxloopError(f"detector.kind: {params.kind}: has {given}; it needs a tuple of some of {', '.join(known)}")
            return cast(Detector, own)


def network_detector(params: NetworkParams, device: torch.device) -> NetworkDetector:
    """luxloop's own, with the weights shipped or others. Raises LuxloopError where these are none."""
    if params.weights is not None:
        with located("detector.weights"):
            network, classes = load(Path(params.weights), device)
    else:
        with as_file(files("perception.detection") / WEIGHTS) as file:
            network, classes = load(file, device)
    return NetworkDetector(network, classes, params.threshold, params.overlap)


def own_detections(own: Detector, frame: Tensor, kind: str) -> Detections:
    """What the user's own detector finds in a frame `[height, width]`. Raises LuxloopError where it fails, or gives something else."""
    where, classes = f"detector.kind: {kind}: detect", len(own.classes)
    try:
        (found,) = own.detect(frame[None])
        shapes = tuple(found.boxes.shape), tuple(found.scores.shape)
        finite = bool(found.boxes.isfinite().all() and found.scores.isfinite().all())
    except Exception as error:
        raise LuxloopError(f"{where} fails ({plugin.in_a_line(error)}); it must {GIVES}") from error
    count = next(iter(shapes[0]), 0)
    if shapes != ((count, 4), (count, classes)) or not finite:
        what = f"boxes {list(shapes[0])} and scores {list(shapes[1])}" + ("" if finite else ", some of which are not finite")
        raise LuxloopError(f"{where} gives {what}; with {classes} classes it must {GIVES}")
    return found
