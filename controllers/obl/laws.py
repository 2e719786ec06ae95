"""Laws of an object's loop: from the illuminances tried so far to the one to try next, or to the one to stay at (T 9.3)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal, Self

from pydantic import Field, model_validator

from world.params import Params


@dataclass(frozen=True)
class Trial:
    """What came of an illuminance in lx: the mean confidence over some frames."""

    lx: float
    confidence: float


@dataclass(frozen=True)
class Next:
    """An illuminance in lx, to be tried, or to stay at."""

    lx: float
    settled: bool


class LowerParams(Params):
    """Bright at once, then down by bisection as long as the confidence stays."""

    kind: Literal["lower"] = "lower"
    bright_lx: float = Field(20.0, gt=0, le=1e6, description="what a new object gets at once; it shows what full light would bring")
    least_lx: float = Field(2.0, gt=0, le=1e6, description="it gets hardly less than this")
    ratio: float = Field(
        1.5, gt=1, le=1e6, description="when the least that is enough is so close to the greatest that is not, the search ends"
    )
    tolerance: float = Field(0.02, ge=0, le=1, description="confidence that may be lost against the best")
    confirm: int = Field(2, ge=1, le=10, description="so often has an illuminance to prove enough before it is kept")

    @model_validator(mode="after")
    def _downwards(self) -> Self:
        if self.bright_lx < self.least_lx:
            raise ValueError(f"bright_lx: {self.bright_lx:g} lx is below least_lx, {self.least_lx:g} lx; give more")
        return self

    @property
    def bounds_lx(self) -> tuple[float, float]:
        """Of the search for a new object's light."""
        return self.least_lx, self.bright_lx

    def next(self, trials: Sequence[Trial], bounds_lx: tuple[float, float]) -> Next:
        """Halves the gap, in the logarithm, between the least that keeps the confidence and the greatest below it that does not."""
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
    """Step by step up until the confidence stays, or falls (T 9.3)."""

    kind: Literal["raise"] = "raise"
    first_lx: float = Field(1.0, gt=0, le=1e6, description="what a new object gets")
    factor: float = Field(2.0, gt=1, le=1e6, description="from step to step")
    most_lx: float = Field(40.0, gt=0, le=1e6, description="it gets no more than this")
    gain: float = Field(0.04, ge=0, le=1, description="a step that brings less confidence is a sign of the plateau")
    patience: int = Field(2, ge=1, le=10, description="so many such steps end the search")

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.first_lx > self.most_lx:
            raise ValueError(f"first_lx: {self.first_lx:g} lx is above most_lx, {self.most_lx:g} lx; give less")
        return self

    @property
    def bounds_lx(self) -> tuple[float, float]:
        """Of the search for a new object's light."""
        return self.first_lx, self.most_lx

    def next(self, trials: Sequence[Trial], bounds_lx: tuple[float, float]) -> Next:
        """One factor more, or back to the best step."""
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
