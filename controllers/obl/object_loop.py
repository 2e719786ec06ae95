"""The loop of one object: its light is searched, kept, watched, and searched anew where what is seen has changed (T 9.3)."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field

from controllers.functions.situation import TrackedObject
from controllers.obl.laws import LowerParams, RaiseParams, Trial, means
from world.params import Params
from world.tracked import Category

RECENT = 0.3  # weight of the last frame in the recent mean
FOLLOWING = 0.2  # share of a new mean in what is expected of a settled object, which follows slow changes that are not the light's


@dataclass(frozen=True)
class ObjectLoop:
    """State. lx: the setpoint. scores: of frames in this light that have not been averaged yet, 0 where the object was not found.

    trials: of the search. expected: confidence, once settled. category, distance_m: when the search began. recent: weighted mean of the
    latest scores. peak: the highest mean that any light has brought.
    """

    lx: float
    category: Category
    distance_m: float
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
    drop: float = Field(0.15, gt=0, le=1, description="so much less confidence than expected begins the search anew")
    change: float = Field(1.5, gt=1, description="so does a distance that has changed by this factor")

    def start(self, each: TrackedObject, distance_m: float) -> ObjectLoop:
        """The loop of a new object."""
        return ObjectLoop(self.search.next(()).lx, each.category, distance_m, recent=_found(each))

    def step(self, loop: ObjectLoop, each: TrackedObject, distance_m: float) -> ObjectLoop:
        """After one more frame of the object in the light that the loop asked for."""
        score = _found(each)
        loop = replace(loop, recent=loop.recent + RECENT * (score - loop.recent), scores=(*loop.scores, score))
        if len(loop.scores) < (self.watch_frames if loop.settled else self.frames):
            return loop
        mean = sum(loop.scores) / len(loop.scores)
        loop = replace(loop, scores=(), peak=max(loop.peak, mean))
        changed = each.category != loop.category or not 1 / self.change < distance_m / loop.distance_m < self.change
        if changed or (loop.settled and mean < loop.expected - self.drop):
            return replace(self.start(each, distance_m), recent=loop.recent, peak=loop.peak)
        if loop.settled:
            return replace(loop, expected=loop.expected + FOLLOWING * (mean - loop.expected))
        trials = (*loop.trials, Trial(loop.lx, mean))
        following = self.search.next(trials)
        expected = means(trials).get(following.lx, 0.0)
        return replace(loop, lx=following.lx, settled=following.settled, trials=trials, expected=expected)


def _found(each: TrackedObject) -> float:
    return 0.0 if math.isnan(each.score) else each.score
