"""The ambient loop: the least share of the base beam at which all tracked objects stay detected (T 9.3)."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Self

from pydantic import Field, model_validator

from luxloop.world.params import Params


@dataclass(frozen=True)
class Ambient:
    """State of the loop. share: of the base beam, 0..1. rested: frames since the last step. risen: whether that step was up."""

    share: float
    rested: int = 0
    risen: bool = False


class AmbientLoopParams(Params):
    """Dims the base beam in steps, raises it at once if needed, and then waits long before it dims again, so that it does not hunt."""

    first: float = Field(1.0, ge=0, le=1, description="share of the base beam at the start, which should show everything present")
    least: float = Field(0.05, gt=0, le=1, description="lower limit of the share, for objects not yet detected")
    fall: float = Field(0.5, gt=0, lt=1, description="factor of a step down, taken when every object is detected surely")
    fall_frames: int = Field(4, ge=1, le=300, description="frames before a step down")
    rise: float = Field(
        2.0, gt=1, le=1e6, description="factor of a step up, taken when an object is doubtful and more light on it does not help"
    )
    patience: int = Field(60, ge=1, le=1_000_000, description="frames without another step after a step up")
    doubtful: float = Field(0.2, ge=0, le=1, description="confidence below which an object that had more is doubtful")
    margin: float = Field(0.1, ge=0, le=1, description="confidence above `doubtful` from which on an object is detected surely")

    @model_validator(mode="after")
    def _begins_above(self) -> Self:
        if self.first < self.least:
            raise ValueError(f"first: {self.first:g} is below least, {self.least:g}; give least or more")
        return self

    def sure(self, confidence: float) -> bool:
        return confidence >= self.doubtful + self.margin

    def step(self, ambient: Ambient, confidences: Collection[float], exhausted: Collection[float]) -> Ambient:
        """The state after one more frame. confidences: current ones of all objects in view that have ever been detected surely.

        exhausted: the confidences of those among them for which more light of their own does not help; the base beam rises for these only.
        """
        rested = ambient.rested + 1
        if min(exhausted, default=1.0) < self.doubtful and ambient.share < 1 and rested >= (self.patience if ambient.risen else 1):
            return Ambient(min(self.rise * ambient.share, 1.0), risen=True)
        sure = all(self.sure(confidence) for confidence in confidences)
        if sure and ambient.share > self.least and rested >= (self.patience if ambient.risen else self.fall_frames):
            return Ambient(max(self.fall * ambient.share, self.least))
        return replace(ambient, rested=rested)
