"""Search laws of an object's loop: from the illuminances tried so far to the next one, or to the final one (T 9.3)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal, Self

from pydantic import Field, model_validator

from luxloop.world.params import Params


@dataclass(frozen=True)
class Trial:
    """A tried illuminance in lx and the mean confidence over some frames in it."""

    lx: float
    confidence: float


@dataclass(frozen=True)
class Next:
    """The next illuminance in lx, to try or, at the end of the search, to keep."""

    lx: float
    settled: bool


class LowerParams(Params):
    """Starts bright, then bisects downwards as long as the confidence stays."""

    kind: Literal["lower"] = "lower"
    bright_lx: float = Field(20.0, gt=0, le=1e6, description="first illuminance on a new object; it gives the confidence in full light")
    least_lx: float = Field(2.0, gt=0, le=1e6, description="approximate lower limit of the illuminance")
    ratio: float = Field(
        1.5,
        gt=1,
        le=1e6,
        description="the search ends when the ratio of least sufficient to greatest insufficient illuminance is below this",
    )
    tolerance: float = Field(0.02, ge=0, le=1, description="loss of confidence against the best that is accepted")
    confirm: int = Field(2, ge=1, le=10, description="trials that must find an illuminance sufficient before it is kept")

    @model_validator(mode="after")
    def _downwards(self) -> Self:
        if self.bright_lx < self.least_lx:
            raise ValueError(f"bright_lx: {self.bright_lx:g} lx is below least_lx, {self.least_lx:g} lx; give more")
        return self

    @property
    def bounds_lx(self) -> tuple[float, float]:
        """Bounds in lx of the search for a new object."""
        return self.least_lx, self.bright_lx

    def next(self, trials: Sequence[Trial], bounds_lx: tuple[float, float]) -> Next:
        """The logarithmic middle between the least illuminance that keeps the confidence and the greatest below it that does not."""
        least, most = bounds_lx
        if all(trial.lx < most for trial in trials):
            return Next(most, False)
        confidence = means(trials)
        best = max(confidence, key=confidence.__getitem__)
        lost = [lx for lx, mean in confidence.items() if lx < best and mean < confidence[best] - self.tolerance]
        low = max(lost, default=least)
        high = min(lx for lx in confidence if lx > low or lx == best)
        if high > self.ratio * low:
            return Next(math.sqrt(low * high), False)
        return Next(high, sum(trial.lx == high for trial in trials) >= self.confirm)


class RaiseParams(Params):
    """Raises the light step by step until the confidence stays or falls (T 9.3)."""

    kind: Literal["raise"] = "raise"
    first_lx: float = Field(1.0, gt=0, le=1e6, description="first illuminance on a new object")
    factor: float = Field(2.0, gt=1, le=1e6, description="factor of a step")
    most_lx: float = Field(40.0, gt=0, le=1e6, description="upper limit of the illuminance")
    gain: float = Field(0.04, ge=0, le=1, description="a step that gains less confidence than this counts as plateau")
    patience: int = Field(2, ge=1, le=10, description="number of such steps that ends the search")

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.first_lx > self.most_lx:
            raise ValueError(f"first_lx: {self.first_lx:g} lx is above most_lx, {self.most_lx:g} lx; give less")
        return self

    @property
    def bounds_lx(self) -> tuple[float, float]:
        """Bounds in lx of the search for a new object."""
        return self.first_lx, self.most_lx

    def next(self, trials: Sequence[Trial], bounds_lx: tuple[float, float]) -> Next:
        """The illuminance one factor higher, or that of the best step."""
        least, most = bounds_lx
        if not trials:
            return Next(least, False)
        best, without = -math.inf, 0
        for trial in trials:
            without = 0 if trial.confidence >= best + self.gain else without + 1
            best = max(best, trial.confidence)
        lx = trials[-1].lx * self.factor
        if without < self.patience and lx <= most:
            return Next(lx, False)
        return Next(max(trials, key=lambda trial: trial.confidence).lx, True)


def means(trials: Sequence[Trial]) -> dict[float, float]:
    """Mean confidence by illuminance in lx, over all trials of it."""
    ordered = sorted(trials, key=lambda trial: trial.lx)
    groups = ((lx, [trial.confidence for trial in group]) for lx, group in groupby(ordered, key=lambda trial: trial.lx))
    return {lx: sum(found) / len(found) for lx, found in groups}
