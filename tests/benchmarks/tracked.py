"""What tests of the tracker show it."""

import torch

from benchmarks.tracking import CLASSES, RATE_HZ, TRACKER, VIEW
from luxloop.perception.detection.detector import Detections
from luxloop.perception.tracking import Tracker, TrackerParams, Tracks

BOX = (300.0, 126.0, 340.0, 226.0)  # of a pedestrian of 1.75 m
NOTHING = Detections(torch.zeros(0, 4), torch.zeros(0, len(CLASSES)))


def detections(*boxes: tuple[float, float, float, float], scores: list[list[float]] | None = None) -> Detections:
    given = scores or [[0.8, 0.1, 0.05, 0.0]] * len(boxes)
    return Detections(torch.tensor(boxes, dtype=torch.float32).view(-1, 4), torch.tensor(given).view(-1, len(CLASSES)))


def plate(x: float, y: float, width_m: float, height_m: float) -> tuple[float, float, float, float]:
    """Its box, upright on the road."""
    corners = torch.tensor([[x, y + width_m / 2, height_m], [x, y - width_m / 2, 0.0]], dtype=torch.float64).T
    left, top, right, bottom = VIEW.project(corners)[0].T.flatten().tolist()
    return left, top, right, bottom


def shown(frames: int, params: TrackerParams = TRACKER.params, then: int = 0, rate_hz: float = RATE_HZ) -> Tracks:
    """Tracks after so many frames with one box, then so many with none."""
    tracker = Tracker(CLASSES, VIEW, params)
    tracks = tracker.start()
    for k in range(frames + then):
        tracks = tracker.step(tracks, detections(BOX) if k < frames else NOTHING, k / rate_hz)
    return tracks
