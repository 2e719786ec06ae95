"""The loop of one object: its light is searched, kept, watched, and searched again where what is seen has changed (T 9.3)."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field

from controllers.obl.laws import LowerParams, RaiseParams, Trial, means
from controllers.situation import TrackedObject
from world.params import Params
from world.traffic.tracked import Category

RECENT = 0.3  # weight of the last frame in the recent mean
FOLLOWING = 0.2  # share of a new mean in what is expected of a settled object, which follows slow changes that are not the light's


@dataclass(frozen=True)
class ObjectLoop:
    """State. lx: the setpoint. bounds_lx: of the search. category, height_rad: of the object as the lamps see it, when the search began.

    scores: of frames in this light that have not been averaged yet, 0 where the object was not found. trials: of the search.
    expected: confidence, once settled. recent: weighted mean of the latest scores. peak: the highest mean that any light has brought.
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
    """How the light of each object is found."""

    search: Annotated[LowerParams | RaiseParams, Field(discriminator="kind")] = Field(
        LowerParams(), description='`kind = "lower"` begins bright, `"raise"` dark'
    )
    frames: int = Field(6, ge=1, le=100, description="frames that are averaged at each step")
    watch_frames: int = Field(15, ge=1, le=300, description="the same once settled")
    drop: float = Field(
        0.1, gt=0, le=1, description="so much less or more confidence than expected begins a search up to the brightest light"
    )
    change: float = Field(
        1.5,
        gt=1,
        le=1e6,
        description="an apparent height that has changed by this factor begins a search around the setpoint, as another class does",
    )
    around: float = Field(2.0, gt=1, le=1e6, description="up to so many times the setpoint, and down to such a part of it")

    @property
    def first_lx(self) -> float:
        """What a new object gets."""
        return self.search.next((), self.search.bounds_lx).lx

    def start(self, each: TrackedObject, height_rad: float) -> ObjectLoop:
        """The loop of a new object."""
        return ObjectLoop(self.first_lx, self.search.bounds_lx, each.category, height_rad, recent=_found(each))

    def exhausted(self, loop: ObjectLoop) -> bool:
        """Whether only the base beam can do more: settled at the brightest light, or after a search up to that, which brought no more."""
        most = self.search.bounds_lx[1]
        return loop.settled and (loop.lx >= most or (loop.bounds_lx[1] >= most and loop.recent > loop.expected - self.drop))

    def step(self, loop: ObjectLoop, each: TrackedObject, height_rad: float) -> ObjectLoop:
        """After one more frame of the object in the light that the loop asked for."""
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
