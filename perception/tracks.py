"""The protocol and reports of trackers, and the state of luxloop's own; all are values that can be stored, sent and resumed."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import torch
from torch import Tensor

from luxloop.perception.detection.protocol import Detections


@dataclass(frozen=True, eq=False)
class TrackedBoxes:
    """A tracker's report at a time: n tracks, C classes.

    number: `[n]` int64 from 1 on, unique identity. boxes: `[n, 4]` px, left, top, right, bottom, including hidden parts and parts outside
    the image. category: `[n]` int64, index of the class. confidence: `[n, C]` in 0..1, of each class. score: `[n, C]`, the same in the last
    frame alone, NaN if not detected. since_s: `[n]`, time of the first report. until_s: `[n]`, time of loss, inf if not lost; a lost track
    is reported for 2 s, so that its light can fade.
    """

    number: Tensor
    boxes: Tensor
    category: Tensor
    confidence: Tensor
    score: Tensor
    since_s: Tensor
    until_s: Tensor

    @classmethod
    def of(cls, number: Tensor, found: Detections, since_s: Tensor) -> Self:
        """Tracks `[n]` at the places of a frame's detections, with their scores."""
        scores = found.scores
        return cls(number, found.boxes, scores.argmax(-1), scores, scores, since_s, torch.full_like(since_s, torch.inf))

    def __len__(self) -> int:
        return len(self.number)

    @property
    def present(self) -> "TrackedBoxes":
        """The tracks that are not lost."""
        return TrackedBoxes(*(value[self.until_s.isinf()] for value in vars(self).values()))


class ObjectTracker(Protocol):
    """Tracks detections from frame to frame; its state is a value."""

    def start(self) -> Any:
        """The state before the first frame."""
        ...

    def follow(self, state: Any, found: Detections, frame: Tensor, time_s: float) -> Any:
        """The state after a frame `[height, width]` (digital numbers as shares 0..1 of the largest) and the detections in it."""
        ...

    def report(self, state: Any, time_s: float) -> TrackedBoxes:
        """The objects, predicted to a time at or after that of the last frame."""
        ...


@dataclass(frozen=True, eq=False)
class Tracks:
    """All n tracks after a frame at time_s, C classes. following: number of the next new track.

    number: `[n]`, the identity. mean: `[n, 2, 2]`, u and v of the foot in px and their rates a second. covariance: `[n, 2, 2, 2]`. size_m:
    `[n, 2]`, width and height. frames: `[n]`, number of frames with a detection. since_s, seen_s, until_s: `[n]`, times of confirmation,
    last detection and loss; inf: not yet. category: `[n]`, index of the class. confidence: `[n, C]`, filtered. score: `[n, C]` in this
    frame, NaN if not detected.
    """

    time_s: float
    number: Tensor
    mean: Tensor
    covariance: Tensor
    size_m: Tensor
    frames: Tensor
    since_s: Tensor
    seen_s: Tensor
    until_s: Tensor
    category: Tensor
    confidence: Tensor
    score: Tensor
    following: int

    def __len__(self) -> int:
        return len(self.number)

    def take(self, which: Tensor) -> "Tracks":
        """The tracks of indices or of a mask."""
        return replace(self, **{name: getattr(self, name)[which] for name in EACH})

    @property
    def known(self) -> "Tracks":
        """The confirmed tracks, lost ones included."""
        return self.take(self.since_s.isfinite())

    @property
    def present(self) -> "Tracks":
        """The confirmed tracks that are not lost."""
        return self.take(self.since_s.isfinite() & self.until_s.isinf())


EACH = ("number", "mean", "covariance", "size_m", "frames", "since_s", "seen_s", "until_s", "category", "confidence", "score")
