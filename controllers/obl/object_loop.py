"""The loop of one object: search its illuminance, keep and monitor it, and search again when the view has changed (T 9.3)."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field

from luxloop.controllers.obl.laws import LowerParams, RaiseParams, Trial, means
from luxloop.controllers.situation import TrackedObject
from luxloop.world.params import Params
from luxloop.world.traffic.tracked import Category

RECENT = 0.3  # weight of the newest frame in the recent mean
FOLLOWING = 0.2  # weight of a new mean in the expected confidence of a settled object, to follow slow changes with other causes than light


@dataclass(frozen=True)
class ObjectLoop:
    """State of the loop. lx: setpoint. bounds_lx: of the search. category, height_rad: class and apparent height when the search began.

    scores: confidences of frames in this light that are not averaged yet, 0 where the object was not detected. trials: of the search.
    expected: expected confidence, once settled. recent: weighted mean of the latest scores. peak: highest mean in any light.
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
    drop: float = Field(
        0.1, gt=0, le=1, description="deviation from the expected confidence that starts a search up to the brightest light"
    )
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
        return self.search.next((), self.search.bounds_lx).lx

    def start(self, each: TrackedObject, height_rad: float) -> ObjectLoop:
        """The loop of a new object."""
        return ObjectLoop(self.first_lx, self.search.bounds_lx, each.category, height_rad, recent=_found(each))

    def exhausted(self, loop: ObjectLoop) -> bool:
        """Whether only the base beam can help: settled at the brightest light, or after a search up to it that did not raise the
        confidence.
        """
        most = self.search.bounds_lx[1]
        return loop.settled and (loop.lx >= most or (loop.bounds_lx[1] >= most and loop.recent > loop.expected - self.drop))

    def step(self, loop: ObjectLoop, each: TrackedObject, height_rad: float) -> ObjectLoop:
        """The state after one more frame of the object in the light that the loop demanded."""
        score = _found(each)
        loop = replace(loop, recent=loop.recent + RECENT * (score - loop.recent), scores=(*loop.scores, score))
        if len(loop.scores) < (self.watch_frames if loop.settled else self.frames):
            return loop
        mean = sum(loop.scores) / len(loop.scores)
        loop = replace(loop, scores=(), peak=max(loop.peak, mean))
        if loop.settled:
            low, high = sorted((height_rad, loop.height_rad))
            changed = each.category != loop.category or high > self.change * low
            other = abs(mean - loop.expected) > self.drop
            if not changed and not other:
                return replace(loop, expected=loop.expected + FOLLOWING * (mean - loop.expected))
            least, most = self.search.bounds_lx
            bounds_lx = max(loop.lx / self.around, least), most if other else min(loop.lx * self.around, most)
            loop = replace(loop, bounds_lx=bounds_lx, category=each.category, height_rad=height_rad, trials=())
        trials = (*loop.trials, Trial(loop.lx, mean))
        following = self.search.next(trials, loop.bounds_lx)
        expected = means(trials).get(following.lx, 0.0)
        return replace(loop, lx=following.lx, settled=following.settled, trials=trials, expected=expected)


def _found(each: TrackedObject) -> float:
    return 0.0 if math.isnan(each.score) else each.score
