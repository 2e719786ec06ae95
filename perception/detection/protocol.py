"""What every detector of objects is: frames in, boxes with a score for each class out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from world.traffic.tracked import Category


@dataclass(frozen=True)
class Detections:
    """What is found in one frame; detectors give the surest first, trackers take any order.

    boxes: `[n, 4]` px, left, top, right, bottom, of what is seen and what is hidden. scores: `[n, C]` in 0..1, one for each class of the
    detector.
    """

    boxes: Tensor
    scores: Tensor

    def __len__(self) -> int:
        return len(self.boxes)


class Detector(Protocol):
    """Finds objects in grey frames. Has no memory from frame to frame."""

    @property
    def classes(self) -> tuple[Category, ...]:
        """What its scores are of."""
        ...

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        """One for each of the frames `[B, height, width]`: digital numbers as a share 0..1 of the largest."""
        ...
