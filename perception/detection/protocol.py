"""The protocol of object detectors: from frames to boxes with a score for each class."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from luxloop.world.traffic.tracked import Category


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
