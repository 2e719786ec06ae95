"""Which light a frame shows, by the time that passed from sending the light to the frame's arrival. In doubt it shows none."""

from typing import Literal

from loop.rig.params import TimingParams

Verdict = Literal["old", "mixed", "clear"]


def shows(lag_s: float, timing: TimingParams) -> Verdict:
    """What a free-running camera's frame shows that arrives `lag_s` after light was sent, which has stood since.

    A frame whose exposure begins just when the light is there arrives `latency_s` after it was sent, and up to `jitter_s` later. So one
    that arrives later than both together began after the light was there: it is clear. One that arrives `rolling_s` before `latency_s` has
    ended its last exposure before the light was there: it shows the old light alone. All between may be mixed.
    """
    if lag_s > timing.clear_s:
        return "clear"
    return "old" if lag_s <= timing.latency_s - timing.rolling_s else "mixed"
