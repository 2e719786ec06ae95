"""The detector that a scenario names."""

from importlib.resources import as_file, files
from pathlib import Path
from typing import cast

import torch

from perception.detection.hog import HogDetector
from perception.detection.network import NetworkDetector, load
from perception.detection.onnx import OnnxDetector
from perception.detection.params import HogParams, NetworkParams, OnnxParams, OwnDetector, RunParams
from perception.detection.protocol import Detector
from world import plugin
from world.errors import located

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
            return cast(Detector, plugin.make(params.kind, "detector.kind", {"device": device}, params.options, ["detect"]))


def network_detector(params: NetworkParams, device: torch.device) -> NetworkDetector:
    """luxloop's own, with the weights shipped or others. Raises LuxloopError where these are none."""
    if params.weights is not None:
        with located("detector.weights"):
            network, classes = load(Path(params.weights), device)
    else:
        with as_file(files("perception.detection") / WEIGHTS) as file:
            network, classes = load(file, device)
    return NetworkDetector(network, classes, params.threshold, params.overlap)
