"""The loops of object-based lighting: light on one object, and the share of the base beam (T 9.3).

An object's loop searches the illuminance by one of two search laws, keeps it, monitors the confidence, and searches again when the view has
changed.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter
from typing import Annotated, Literal

from pydantic import Field

from luxloop.controllers.situation import SURE, TrackedObject
from luxloop.world.params import Params, Positive, PositiveShare, Share, in_order
from luxloop.world.traffic.tracked import Category

Trial = tuple[float, float]  # an illuminance in lx, and the mean confidence of the object over some frames in it
Decision = tuple[float, bool]  # the next illuminance in lx, and whether the search ends with it


class LowerParams(Params):
    """Starts bright, then bisects downwards while the confidence stays."""

    kind: Literal["lower"] = "lower"
    bright_lx: Positive = Field(20.0, description="first illuminance on a new object, which gives the confidence in full light")
    least_lx: Positive = Field(2.0, description="approximate lower limit of the illuminance")
    ratio: float = Field(
        1.5,
        gt=1,
        le=1e6,
        description="the search ends when the ratio of least sufficient to greatest insufficient illuminance is below this",
    )
    tolerance: Share = Field(0.02, description="loss of confidence against the best that is accepted")
    confirm: int = Field(2, ge=1, le=10, description="trials that must find an illuminance sufficient before it is kept")

    _bounds_in_order = in_order("least_lx", "bright_lx", strict=False)

    @property
    def bounds_lx(self) -> tuple[float, float]:
        """Bounds in lx of the search for a new object."""
        return self.least_lx, self.bright_lx

    def next(self, trials: Sequence[Trial], bounds_lx: tuple[float, float]) -> Decision:
        """The geometric mean of the least illuminance that keeps the confidence and the greatest below it that does not."""
        least, most = bounds_lx
        if all(lx < most for lx, _ in trials):
            return most, False
        confidence = means(trials)
        best = max(confidence, key=confidence.__getitem__)
        lost = [lx for lx, mean in confidence.items() if lx < best and mean < confidence[best] - self.tolerance]
        low = max(lost, default=least)
        high = min(lx for lx in confidence if lx > low or lx == best)
        if high > self.ratio * low:
            return math.sqrt(low * high), False
        return high, sum(lx == high for lx, _ in trials) >= self.confirm


class RaiseParams(Params):
    """Raises the light step by step until the confidence stays or falls (T 9.3)."""

    kind: Literal["raise"] = "raise"
    first_lx: Positive = Field(1.0, description="first illuminance on a new object")
    factor: float = Field(2.0, gt=1, le=1e6, description="factor of a step")
    most_lx: Positive = Field(40.0, description="upper limit of the illuminance")
    gain: Share = Field(0.04, description="a step that gains less confidence than this counts as plateau")
    patience: int = Field(2, ge=1, le=10, description="number of such steps that ends the search")

    _bounds_in_order = in_order("first_lx", "most_lx", strict=False)

    @property
    def bounds_lx(self) -> tuple[float, float]:
        """Bounds in lx of the search for a new object."""
        return self.first_lx, self.most_lx

    def next(self, trials: Sequence[Trial], bounds_lx: tuple[float, float]) -> Decision:
        """The illuminance one step higher, or at the end the illuminance of the best step."""
        least, most = bounds_lx
        if not trials:
            return least, False
        best, without = -math.inf, 0
        for _, confidence in trials:
            without = 0 if confidence >= best + self.gain else without + 1
            best = max(best, confidence)
        lx = trials[-1][0] * self.factor
        if without < self.patience and lx <= most:
            return lx, False
        return max(trials, key=itemgetter(1))[0], True


def means(trials: Sequence[Trial]) -> dict[float, float]:
    """Mean confidence over all trials, by illuminance in lx."""
    groups = ((lx, [confidence for _, confidence in group]) for lx, group in groupby(sorted(trials, key=itemgetter(0)), itemgetter(0)))
    return {lx: sum(found) / len(found) for lx, found in groups}


RECENT = 0.3  # weight of the newest frame in the recent mean
FOLLOWING = 0.2  # weight of a new mean in the expected confidence of a settled object, to follow slow changes with other causes than light


@dataclass(frozen=True)
class ObjectLoop:
    """State of an object's loop. lx: setpoint. bounds_lx: bounds of the search. category, height_rad: class and apparent height at the
    start of the search.

    scores: confidences at this setpoint since the last mean, 0 without detection. trials: of the search. expected: expected confidence,
    once settled. recent: weighted mean of the latest scores. peak: highest mean at any setpoint.
    """

    lx: float
    bounds_lx: tuple[float, float]
    category: Category
    height_rad: float
    settled: bool = False
    scores: tuple[float, ...] = ()
    trials: tuple[Trial, ...] = ()
    expected: float = 0.0
    recent: float = 0.0
    peak: float = 0.0


class ObjectLoopParams(Params):
    """Search and monitoring of the light on each object."""

    search: Annotated[LowerParams | RaiseParams, Field(discriminator="kind")] = Field(
        LowerParams(), description='`kind = "lower"` starts bright, `"raise"` dark'
    )
    frames: int = Field(6, ge=1, le=100, description="frames averaged per trial of the search")
    watch_frames: int = Field(15, ge=1, le=300, description="frames averaged once settled")
    drop: PositiveShare = Field(0.1, description="deviation from the expected confidence that starts a search up to the brightest light")
    change: float = Field(
        1.5,
        gt=1,
        le=1e6,
        description="a change of apparent height by this factor, or of class, starts a search around the setpoint",
    )
    around: float = Field(
        2.0, gt=1, le=1e6, description="range of that search: from the setpoint divided by this to the setpoint times this"
    )

    @property
    def first_lx(self) -> float:
        """First illuminance in lx on a new object."""
        return self.search.next((), self.search.bounds_lx)[0]

    def start(self, each: TrackedObject, height_rad: float) -> ObjectLoop:
        """The loop of a new object."""
        return ObjectLoop(self.first_lx, self.search.bounds_lx, each.category, height_rad, recent=_found(each))

    def at_limit(self, loop: ObjectLoop) -> bool:
        """Whether more light on the object cannot help: settled at the brightest light, or after a search up to the brightest light that
        did not raise the confidence.
        """
        most = self.search.bounds_lx[1]
        return loop.settled and (loop.lx >= most or (loop.bounds_lx[1] >= most and loop.recent > loop.expected - self.drop))

    def step(self, loop: ObjectLoop, each: TrackedObject, height_rad: float) -> ObjectLoop:
        """The state after a frame of the object in the commanded light. One that was sure gets more light once its track is doubtful."""
        score, (least, most) = _found(each), self.search.bounds_lx
        doubtful = loop.settled and loop.lx < most and each.confidence < SURE <= loop.expected
        loop = replace(loop, recent=loop.recent + RECENT * (score - loop.recent), scores=(*loop.scores, score))
        if len(loop.scores) < (self.watch_frames if loop.settled else self.frames) and not doubtful:
            return loop
        mean = sum(loop.scores) / len(loop.scores)
        loop = replace(loop, scores=(), peak=max(loop.peak, mean))
        if loop.settled:
            low, high = sorted((height_rad, loop.height_rad))
            changed = each.category != loop.category or high > self.change * low
            other = doubtful or abs(mean - loop.expected) > self.drop
            if not changed and not other:
                return replace(loop, expected=loop.expected + FOLLOWING * (mean - loop.expected))
            bounds_lx = max(loop.lx / self.around, least), most if other else min(loop.lx * self.around, most)
            loop = replace(loop, bounds_lx=bounds_lx, category=each.category, height_rad=height_rad, trials=())
        trials = (*loop.trials, (loop.lx, mean))
        lx, settled = self.search.next(trials, loop.bounds_lx)
        return replace(loop, lx=lx, settled=settled, trials=trials, expected=means(trials).get(lx, 0.0))


def _found(each: TrackedObject) -> float:
    return 0.0 if math.isnan(each.score) else each.score


@dataclass(frozen=True)
class Ambient:
    """State of the ambient loop. share: of the base beam, 0..1. rested: frames since the last step. risen: whether the last step was up."""

    share: float
    rested: int = 0
    risen: bool = False


class AmbientLoopParams(Params):
    """Dims the base beam in steps, raises it at once if needed, and then waits before dimming again, so that the loop does not hunt."""

    first: Share = Field(1.0, description="share of the base beam at the start, which should show all objects")
    least: PositiveShare = Field(0.05, description="lower limit of the share, for objects not yet detected")
    fall: float = Field(0.5, gt=0, lt=1, description="factor of a step down, taken when every object is detected surely")
    fall_frames: int = Field(4, ge=1, le=300, description="frames before a step down")
    rise: float = Field(
        2.0, gt=1, le=1e6, description="factor of a step up, taken when an object is doubtful although it gets the most light"
    )
    patience: int = Field(60, ge=1, le=1_000_000, description="frames without another step after a step up")
    doubtful: Share = Field(0.2, description="confidence below which an object that had more is doubtful")
    margin: Share = Field(0.1, description="confidence above `doubtful` from which on an object is detected surely")

    _shares_in_order = in_order("least", "first", strict=False)

    def sure(self, confidence: float) -> bool:
        return confidence >= self.doubtful + self.margin

    def step(self, ambient: Ambient, confidences: Collection[float], exhausted: Collection[float]) -> Ambient:
        """The state after a frame. confidences: of all objects in view that were once detected surely. exhausted: confidences of the
        objects that more light on the object cannot help; only these raise the base beam.
        """
        rested = ambient.rested + 1
        if min(exhausted, default=1.0) < self.doubtful and ambient.share < 1 and rested >= (self.patience if ambient.risen else 1):
            return Ambient(min(self.rise * ambient.share, 1.0), risen=True)
        sure = all(self.sure(confidence) for confidence in confidences)
        if sure and ambient.share > self.least and rested >= (self.patience if ambient.risen else self.fall_frames):
            return Ambient(max(self.fall * ambient.share, self.least))
        return replace(ambient, rested=rested)
