"""Statistics of a run on a rig: delay of frames, used and lost pictures with reasons, and the control rate."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

BIN_S: Final = 0.0005
BINS: Final = 10_000  # up to 5 s; later ones count as the last
MOST_LOSSES: Final = 1000  # of which the number of the exposure is kept
LEAST_FRAMES: Final = 0.8  # share of the exposures: jitter, lost packets and a camera that reconnects cost less
LONGEST_SILENCE: Final = 10  # exposures without a frame at the end, of a rig that died in a long run


@dataclass
class Lateness:
    """Times in a histogram of constant memory."""

    counts: "np.ndarray" = field(default_factory=lambda: np.zeros(BINS, np.int64))
    worst_s: float = 0.0

    def add(self, time_s: float) -> None:
        self.counts[min(max(int(time_s / BIN_S), 0), BINS - 1)] += 1
        self.worst_s = max(self.worst_s, time_s)

    def quantile_s(self, share: float) -> float | None:
        """Quantile in s, None without any times. share: 0..1."""
        total = int(self.counts.sum())
        if not total:
            return None
        at = int(np.searchsorted(np.cumsum(self.counts), share * total))
        return min((at + 0.5) * BIN_S, self.worst_s)

    @property
    def in_ms(self) -> dict[str, float | None]:
        """Median, 95 % quantile and worst in ms."""
        values = {"median": self.quantile_s(0.5), "p95": self.quantile_s(0.95), "worst": self.worst_s if self.counts.any() else None}
        return {name: None if value is None else round(1e3 * value, 2) for name, value in values.items()}


@dataclass
class Statistics:
    """Statistics of a run so far. lateness: from sending light to the arrival of its frame. hold: from the start of an exposure to its
    end. seen: number of pictures by their use. silent: exposures since the newest frame.
    """

    lateness: Lateness = field(default_factory=Lateness)
    hold: Lateness = field(default_factory=Lateness)
    seen: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    losses: list[tuple[int, str]] = field(default_factory=list)
    exposures: int = 0
    silent: int = 0
    dimmed: int = 0
    slowed: int = 0
    began_s: float = 0.0
    ended_s: float = 0.0

    def take(self, lateness_s: float) -> None:
        self.lateness.add(lateness_s)
        self.silent = 0

    def lose(self, number: int, reason: str) -> None:
        self.lost[reason] += 1
        self.silent += 1
        if len(self.losses) < MOST_LOSSES:
            self.losses.append((number, reason))

    @property
    def failure(self) -> str:
        """Why a run is none of a working rig: fewer than 80 % of the exposures have a frame, or none of the last ten; empty if it is."""
        came = self.exposures - self.lost.total()
        if came >= LEAST_FRAMES * self.exposures and self.silent < LONGEST_SILENCE:
            return ""
        silence = f", none of the last {self.silent}" if self.silent else ""
        why = f" ({self.lost.most_common(1)[0][0]})" if self.lost else ""
        return f"frames of only {came} of {self.exposures} exposures came{silence}{why}; see `luxloop rig check` and `luxloop rig blink`"

    def summary(self, per_step: int) -> dict[str, Any]:
        """The statistics as plain data. per_step: exposures per control step."""
        lasted_s = self.ended_s - self.began_s
        return {
            "exposures": self.exposures,
            "lost": dict(self.lost),
            "silent": self.silent,
            "losses": [{"exposure": number, "reason": reason} for number, reason in self.losses],
            "control_rate_hz": round(self.exposures / per_step / lasted_s, 3) if lasted_s > 0 else None,
            "light_to_frame_ms": self.lateness.in_ms,
            "hold_ms": self.hold.in_ms,
            "pictures": dict(self.seen),
            "dimmed": self.dimmed,
            "slowed": self.slowed,
        }
