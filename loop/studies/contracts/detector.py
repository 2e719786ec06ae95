"""Contract of a user's own detector."""

import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from luxloop.loop.run import torch_device
from luxloop.loop.studies.contracts.values import build_part, pure, world
from luxloop.perception.detection.build import KEY, CheckedDetector, own_detector
from luxloop.perception.detection.detector import Detections, OwnDetector
from luxloop.world.errors import LuxloopError

SCENARIO = """
name = "check_detector"
steps = 2
rate_hz = 10.0
camera = { width_px = 640, height_px = 360, oversampling = 1 }
headlight.model = "hd84"
light.ambient_lx = 0.02
renderer = "raycast"
[[objects]]
kind = "pedestrian"
name = "walker"
appears_s = 0.05
track = [{ position_m = [20.0, 2.0, 0.0] }]
[[objects]]
kind = "car"
name = "car"
appears_s = 0.05
track = [{ position_m = [28.0, -2.0, 0.0], yaw_deg = 180.0 }]
"""
ROUNDING = 0.02  # accepted difference in px and score between batches: kernels add in another order


def check_detector(detector: type, options: Mapping[str, Any] | None = None, device: str = "auto") -> None:
    """Check your own detector against the contract of `[detector]`, in a few seconds.

    detector: the class, from which a scenario makes `detector(device, **options)`. options: those of `[detector]`. device: "auto", "cpu" or
    "cuda", of the detector and its frames.

    The check detects in frames `[B, 360, 640]` of a road, dark, in the high beam, and with a pedestrian and a car, one by one and in
    batches. Raises LuxloopError with likely cause and remedy if `detect` or `classes` is missing or wrong; if it fails, changes the frames,
    or gives different results for the same frame or in another batch; if it does not return one `Detections` per frame with finite boxes
    `[n, 4]` (left, top, right, bottom in px, centred in the frame) and scores `[n, classes]` in 0..1. Warns if a detector of pedestrians or
    cars finds nothing.
    """
    found_by = build_part(
        detector,
        KEY,
        {"detect": ("frames",)},
        lambda name: own_detector(detector, OwnDetector(kind=name, options=dict(options or {})), torch_device(device)),
    )
    frames = _frames(device)
    alone = [_detect(found_by, frame[None])[0] for frame in frames]
    where = f"{KEY}: {found_by.own.name}"
    for order in ([0, 1, 2], [2, 1, 0]):
        for k, each in zip(order, _detect(found_by, frames[order]), strict=True):
            if not _alike(alone[k], each):
                raise LuxloopError(
                    f"{where}: detect finds something else in a frame where others are beside it; look at each frame of a batch by itself"
                )
    if not any(map(len, alone)) and {"pedestrian", "car"} & {*found_by.classes}:
        warnings.warn(
            f"{where}: nothing found in {len(frames)} frames, of which one shows a pedestrian and a car; frames are shares 0..1 of "
            "the largest number",
            stacklevel=2,
        )


@cache
def _frames(device: str) -> Tensor:
    """Frames `[3, height, width]` in 0..1: a dark road, the same in the high beam, and with objects."""
    found = []
    for beam, steps in (("off", [0]), ("high", [0, 1])):
        simulation = world(SCENARIO, device, f"lighting.base.beam={beam}")
        found += [frame for step in steps if (frame := simulation.at(step).frame) is not None]
    return torch.stack(found) / (2**simulation.scenario.camera.bits - 1)


def _detect(detector: CheckedDetector, frames: Tensor) -> Sequence[Detections]:
    """Checked detections. Raises LuxloopError if they are invalid or not reproducible."""
    return detector.check(pure(detector.own, "detect", {"frames": frames}, "detections"), frames)


def _alike(one: Detections, other: Detections) -> bool:
    """Whether detections agree up to rounding, in any order."""
    rows = [sorted(torch.cat([each.boxes.cpu(), each.scores.cpu()], 1).double().round(decimals=2).tolist()) for each in (one, other)]
    return len(rows[0]) == len(rows[1]) and bool(((torch.tensor(rows[0]) - torch.tensor(rows[1])).abs() <= ROUNDING).all())
