"""On and off frames, found again by the numbers of their exposures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from torch import Tensor

from luxloop.loop.simulation.protocol import Frame

What = TypeVar("What")
UnderWay = tuple[tuple[int, What], ...]  # what was shown, by the number of its on exposure
LOST = Frame(-1, math.nan, math.nan, None)


@dataclass(frozen=True, eq=False)
class Arrived(Generic[What]):
    """What was shown, with its frames."""

    what: What
    on: Frame
    off: Frame

    @property
    def images(self) -> tuple[Tensor, Tensor] | None:
        """Of on and off frame; None where one is lost."""
        return None if self.on.image is None or self.off.image is None else (self.on.image, self.off.image)

    @property
    def taken_s(self) -> float:
        """When the on frame was taken; NaN where one is lost."""
        return math.nan if self.images is None else self.on.taken_s


def paired(under_way: UnderWay[What], frames: Sequence[Frame]) -> tuple[list[Arrived[What]], UnderWay[What], tuple[Frame, ...]]:
    """What was shown whose frames have come or are lost, at least the oldest; what is under way; its frames so far.

    Frames come in the order of their exposures: all before the last pair that has come are lost. Where none has come, the oldest is
    given again, as lost.
    """
    came = {frame.number: frame for frame in frames}
    done = max((k + 1 for k, (number, _) in enumerate(under_way) if number in came and number + 1 in came), default=0)
    arrived = [Arrived(what, came.get(number, LOST), came.get(number + 1, LOST)) for number, what in under_way[:done]]
    left = under_way[done:]
    awaited = {exposure for number, _ in left for exposure in (number, number + 1)}
    return arrived or [Arrived(left[0][1], LOST, LOST)], left, tuple(frame for frame in frames if frame.number in awaited)
