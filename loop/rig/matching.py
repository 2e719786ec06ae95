"""Which light a frame shows, by the time that passed from sending the light to the frame's arrival. In doubt it shows none."""

import math
import statistics
from collections import deque
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from loop.rig.params import TimingParams

Verdict = Literal["old", "mixed", "clear"]
GAPS: Final = 61  # between pictures, whose median is the camera's period
FEWEST: Final = 8  # gaps by which a period is known
KEPT: Final = 0.9  # of the lateness, from picture to picture: a lost picture looks like lateness, but nothing catches up after it
CATCHING_UP: Final = 0.5  # of the period: pictures closer together come out of a queue, and their lateness is kept whole
IN_TIME: Final = 0.5  # of jitter_s, by which pictures that came in time may be late themselves
STEADY: Final = 0.2  # length of the mean phase of arrivals, 1 without jitter, from which on a period counts as found
RATES: Final = (0.9, 1.6)  # times the rate by the median gap, between which the camera's is looked for: pictures may be lost
TOGETHER: Final = 2000  # pictures whose period is found together at most; within their time a camera's clock is steady
APART: Final = 10.0  # periods after which a camera may have been started again
BINS: Final = 16  # of the median gap, in which pictures are counted to find the rate
FINER: Final = 4  # steps of the rate within which a period more or less comes in the whole time; and steps of such a step then
BESIDE: Final = 1 / 8  # of a period, in which pictures are counted before and after a phase
EARLY: Final = 1 / 4  # of a period, by which pictures may come before most do
WITHIN: Final = 1 / 32  # of a period, in which pictures are counted after each
DENSE: Final = 0.3  # of the largest such number: with fewer, pictures count as more than a period late
FEWEST_TOGETHER: Final = 200  # pictures by which a rhythm is found


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


def needed_s(lateness_s: NDArray[np.float64], told_s: NDArray[np.float64]) -> float:
    """Least `jitter_s` with which `shows` takes none of some pictures for clear too early.

    lateness_s: `[n]`, how much later than the least latency they came. told_s: `[n]`, what `Regularity` has told of it.
    """
    return float(np.minimum(lateness_s, (lateness_s - told_s) / IN_TIME).max(initial=0.0))


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


def lateness(arrived_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much each picture of a free-running camera came later than its rhythm, in s, known afterwards.

    arrived_s: `[n]`, ascending, of pictures of which some may lack. Where there are too few, or they come with jitter of more than three
    quarters of their period, no rhythm is found, and it is 0.
    """
    gaps_s = np.diff(arrived_s)
    stretches = np.split(arrived_s, np.flatnonzero(gaps_s > APART * np.median(gaps_s)) + 1) if len(gaps_s) else [arrived_s]
    parts = [part for each in stretches for part in np.array_split(each, math.ceil(len(each) / TOGETHER) or 1)]
    return np.concatenate([_later_than_rhythm(part - part[:1]) if len(part) >= FEWEST_TOGETHER else np.zeros(len(part)) for part in parts])


def _later_than_rhythm(at_s: NDArray[np.float64]) -> NDArray[np.float64]:
    gap_s = np.median(np.diff(at_s))
    came = np.bincount((at_s * (BINS / gap_s)).astype(int))
    size = FINER * len(came)
    rates = np.fft.rfftfreq(size, gap_s / BINS)
    within = (rates > RATES[0] / gap_s) & (rates < RATES[1] / gap_s)
    about_hz = rates[within][np.abs(np.fft.rfft(came, size))[within].argmax()]
    rates = about_hz + np.linspace(-1, 1, 2 * FINER**2 + 1) / FINER / at_s[-1]
    if np.abs(np.exp(2j * np.pi * rates[:, None] * at_s).mean(1)).max() < STEADY:
        return np.zeros(len(at_s))
    _, begin, rate_hz = max((*_begin(at_s * rate % 1), rate) for rate in rates)
    late_s = at_s - np.floor(at_s * rate_hz - begin + EARLY) / rate_hz
    late_s -= begin / rate_hz
    for _ in range(3):  # the line through the earlier half, so that those that are stuck count for nothing
        early = (late_s >= -WITHIN / rate_hz) & (late_s <= np.median(late_s))
        late_s -= np.polyval(np.polyfit(at_s[early], late_s[early], 1), at_s)
        ordered = np.sort(late_s)
        together = np.searchsorted(ordered, ordered + WITHIN / rate_hz) - np.arange(len(ordered))
        late_s -= ordered[(together > DENSE * together.max()).argmax()]
    return np.maximum(late_s, 0.0)


def _begin(phases: NDArray[np.float64]) -> tuple[int, float]:
    """How many more pictures come just after a phase than just before, and the phase where these are most. phases: `[n]`, 0 to 1."""
    around = np.sort(np.concatenate([phases - 1, phases, phases + 1]))
    before, at, after = (np.searchsorted(around, phases + by) for by in (-BESIDE, 0.0, BESIDE))
    rise = after - 2 * at + before
    return int(rise.max()), float(phases[rise.argmax()])
