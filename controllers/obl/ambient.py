"""The ambient loop: the least share of the base beam in which all that is tracked stays found (T 9.3)."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Self

from pydantic import Field, model_validator

from world.params import Params


@dataclass(frozen=True)
class Ambient:
    """State. share: of the base beam. rested: frames since the last step. risen: whether that led up."""

    share: float
    rested: int = 0
    risen: bool = False


class AmbientLoopParams(Params):
    """How far the base beam is dimmed: down in steps, up at once and then not down for long, so that it does not hunt."""

    first: float = Field(1.0, ge=0, le=1, description="share of the base beam at the beginning, which shall show all that is there")
    least: float = Field(0.05, gt=0, le=1, description="never less than this share of the base beam, for what nobody has found yet")
    fall: float = Field(0.5, gt=0, lt=1, description="factor of a step down, when every object is found for sure")
    fall_frames: int = Field(4, ge=1, le=300, description="frames before a step down")
    rise: float = Field(2.0, gt=1, le=1e6, description="factor of a step up, when one is doubtful that its own light brings no further")
    patience: int = Field(60, ge=1, le=1_000_000, description="frames after a step up without another step")
    doubtful: float = Field(0.2, ge=0, le=1, description="confidence below which an object that has had more may get lost")
    margin: float = Field(0.1, ge=0, le=1, description="above that, for sure")

    @model_validator(mode="after")
    def _begins_above(self) -> Self:
        if self.first < self.least:
            raise ValueError(f"first: {self.first:g} is below least, {self.least:g}; give a share from there on")
        return self

    def sure(self, confidence: float) -> bool:
        return confidence >= self.doubtful + self.margin

    def step(self, ambient: Ambient, confidences: Collection[float], exhausted: Collection[float]) -> Ambient:
        """After one more frame. confidences: now, of all objects in sight that have ever been found for sure.

        exhausted: of those among them that their own light brings no further; for these alone the base beam rises.
        """
        rested = ambient.rested + 1
        if min(exhausted, default=1.0) < self.doubtful and ambient.share < 1 and rested >= (self.patience if ambient.risen else 1):
            return Ambient(min(self.rise * ambient.share, 1.0), risen=True)
        sure = all(self.sure(confidence) for confidence in confidences)
        if sure and ambient.share > self.least and rested >= (self.patience if ambient.risen else self.fall_frames):
            return Ambient(max(self.fall * ambient.share, self.least))
        return replace(ambient, rested=rested)
