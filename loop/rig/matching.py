"""Which light a frame shows, by the time that passed from sending the light to the frame's arrival. In doubt it shows none."""

import math
import statistics
from collections import deque
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from luxloop.loop.rig.params import TimingParams

Verdict = Literal["old", "mixed", "clear"]
GAPS: Final = 61  # between pictures, whose median is the camera's period
FEWEST: Final = 8  # gaps by which a period is known
KEPT: Final = 0.9  # of the lateness, from picture to picture: a lost picture looks like lateness, but nothing catches up after it
CATCHING_UP: Final = 0.5  # of the period: pictures closer together come out of a queue, and their lateness is kept whole
IN_TIME: Final = 0.5  # of jitter_s, by which pictures that came in time may be late themselves


def shows(lag_s: float, timing: TimingParams, late_s: float = 0.0) -> Verdict:
    """What a free-running camera's frame shows that arrives `lag_s` after light was sent, which has stood since.

    A frame whose exposure begins just when the light is there arrives `latency_s` after it was sent, and up to `jitter_s` later, or by
    `late_s` where the camera's own rhythm says that it is later than that. The rhythm is that of pictures which came in time, and these
    may have been late by a part of the jitter, which is added. So one that arrives later than all this began after the light was there: it
    is clear. One that arrives `rolling_s` before `latency_s` has ended its last exposure before the light was there: it shows the old light
    alone. All between may be mixed.
    """
    if lag_s > timing.latency_s + max(timing.jitter_s, late_s + IN_TIME * timing.jitter_s):
        return "clear"
    return "old" if lag_s <= timing.latency_s - timing.rolling_s else "mixed"


def needed_s(lateness_s: NDArray[np.float64], predicted_s: NDArray[np.float64]) -> float:
    """Least `jitter_s` with which `shows` takes none of some pictures for clear too early.

    lateness_s: `[n]`, how much later than `latency_s` they came. predicted_s: `[n]`, the part of it that `Regularity` found.
    """
    return float(np.minimum(lateness_s, (lateness_s - predicted_s) / IN_TIME).max(initial=0.0))


class Regularity:
    """By how much pictures of a free-running camera come later than its period lets expect, counted from those that came in time."""

    def __init__(self) -> None:
        self._gaps, self._late_s = deque[float](maxlen=GAPS), 0.0
        self._last_s: float | None = None

    def late(self, arrived_s: float) -> float:
        """Lateness in s of the next picture, infinite where the period is not known yet.

        Where pictures pile up behind one that is stuck, that one and those behind it are late.
        """
        if self._last_s is not None:
            gap_s = arrived_s - self._last_s
            self._gaps.append(gap_s)
            period_s = statistics.median(self._gaps)
            kept = KEPT if gap_s > CATCHING_UP * period_s else 1.0
            self._late_s = max(kept * self._late_s + gap_s - period_s, 0.0)
        self._last_s = arrived_s
        if len(self._gaps) < FEWEST:
            self._late_s = 0.0
            return math.inf
        return self._late_s
