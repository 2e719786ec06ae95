"""What every tracker is and reports, and what luxloop's own knows after a frame: values, that can be kept, sent and taken up anywhere."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import torch
from torch import Tensor

from perception.detection.protocol import Detections


@dataclass(frozen=True, eq=False)
class TrackedBoxes:
    """What a tracker reports at a time: n tracks, C classes.

    number: `[n]` int64 from 1 on, the identity, which no later track gets. boxes: `[n, 4]` px, left, top, right, bottom, with what is
    hidden or outside of the image. category: `[n]` int64, index of its class. confidence: `[n, C]` in 0..1, of each class. score: `[n, C]`,
    the same in the last frame alone, NaN where it was not found. since_s: `[n]`, when it was first reported. until_s: `[n]`, when it was
    lost, inf for not yet; a lost one is reported for 2 s, so that what is drawn about it can fade.
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
        """Tracks `[n]` that are where a frame shows them, with its scores."""
        scores = found.scores
        return cls(number, found.boxes, scores.argmax(-1), scores, scores, since_s, torch.full_like(since_s, torch.inf))

    def __len__(self) -> int:
        return len(self.number)

    @property
    def present(self) -> "TrackedBoxes":
        """Those that are not lost."""
        return TrackedBoxes(*(value[self.until_s.isinf()] for value in vars(self).values()))


class ObjectTracker(Protocol):
    """Follows from frame to frame what a detector finds; its state is a value."""

    def start(self) -> Any:
        """The state before the first frame."""
        ...

    def follow(self, state: Any, found: Detections, frame: Tensor, time_s: float) -> Any:
        """The state after a frame `[height, width]`, digital numbers as a share 0..1 of the largest, in which that was found."""
        ...

    def report(self, state: Any, time_s: float) -> TrackedBoxes:
        """The objects, where they are expected at a time at or after that of the last frame."""
        ...


@dataclass(frozen=True, eq=False)
class Tracks:
    """All tracks after a frame, at time_s; n of them, C classes. following: the number that the next new one gets.

    number: `[n]`, the identity. mean: `[n, 2, 2]`, u and v of the foot in px and their rates a second. covariance: `[n, 2, 2, 2]`.
    size_m: `[n, 2]`, width and height. frames: `[n]` that showed it. since_s, seen_s, until_s: `[n]`, when it was confirmed, last found and
    lost; inf: not yet. category: `[n]`, index of its class. confidence: `[n, C]`, filtered. score: `[n, C]` in this frame, NaN where it was
    not found.
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
        """Those of indices or of a mask."""
        return replace(self, **{name: getattr(self, name)[which] for name in EACH})

    @property
    def known(self) -> "Tracks":
        """Those that are confirmed, the lost ones among them."""
        return self.take(self.since_s.isfinite())

    @property
    def present(self) -> "Tracks":
        """Those that are confirmed and not lost."""
        return self.take(self.since_s.isfinite() & self.until_s.isinf())


EACH = ("number", "mean", "covariance", "size_m", "frames", "since_s", "seen_s", "until_s", "category", "confidence", "score")
