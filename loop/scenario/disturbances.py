"""Disturbances unknown to the controller: errors of calibration, aim and pixels, and disturbed frames."""

import math
from collections.abc import Iterable
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from luxloop.perception.camera import OncomingParams
from luxloop.world.light.soiling import SoilingParams
from luxloop.world.params import Params, Seed, Share, in_order

FRAMES = ("on", "off")


class Spell(Params):
    """Steps over which a disturbance holds."""

    from_step: int = Field(0, ge=0, le=1_000_000, description="first step")
    until_step: int | None = Field(None, gt=0, le=1_000_000, description="step at which the disturbance is over; left out: never")

    _steps_in_order = in_order("from_step", "until_step")

    def holds(self, step: int) -> bool:
        return self.from_step <= step and (self.until_step is None or step < self.until_step)


class FrameSpell(Spell):
    """Steps over which a disturbance holds, and its frames in each step."""

    frames: Literal["both", "on", "off"] = Field("both", description="disturbed frames of a step")

    def holds_in(self, step: int, frame: int) -> bool:
        """Whether the disturbance holds in a step's on frame (0) or off frame (1)."""
        return self.holds(step) and self.frames in ("both", FRAMES[frame])


class AmbientParams(FrameSpell):
    """A change of the light beside the own headlamps'."""

    factor: float = Field(
        ge=0, le=1000, examples=[2.0], description="all light but the own headlamps': sky, street lamps, other cars' lamps"
    )


class OncomingSpellParams(OncomingParams, FrameSpell):
    """An oncoming headlamp: a source that faces the camera, lights nothing and is hidden by nothing."""


class NoiseParams(Spell):
    """More noise than [camera] has."""

    factor: float = Field(
        ge=0, le=100, examples=[2.0], description="standard deviation of shot and read noise, as a multiple of [camera]'s"
    )


class DropsParams(Spell):
    """Lost frames, besides camera.drop_probability."""

    probability: Share = Field(1.0, description="probability that a step's frames are lost")


class LensParams(SoilingParams, Spell):
    """Spots of dirt or ice on the camera's lens or the windscreen before it."""


class PoseErrorParams(Params):
    """Error of a mounting pose relative to the scenario's."""

    x_m: float = Field(0.0, ge=-0.5, le=0.5, description="further ahead")
    y_m: float = Field(0.0, ge=-0.5, le=0.5, description="further to the left")
    z_m: float = Field(0.0, ge=-0.5, le=0.5, description="higher")
    roll_deg: float = Field(0.0, ge=-10, le=10, description="further right side down")
    pitch_deg: float = Field(0.0, ge=-10, le=10, description="further nose down")
    yaw_deg: float = Field(0.0, ge=-10, le=10, description="further to the left")


class CalibrationParams(PoseErrorParams):
    """Errors of the camera's calibration: differences of the true camera from [camera], which the controller believes."""

    focal_percent: float = Field(0.0, gt=-50, le=50, description="longer focal length")


class AimParams(PoseErrorParams):
    """Errors of the lamps' aim relative to [headlight]; modules turn about their own origins."""

    lamp: Literal["left", "right"] | None = Field(None, description="misaimed lamp; left out: all that shine")


class WearParams(Params):
    """Dead and aged pixels of the modules, drawn for each module that shines."""

    dead: Share = Field(0.0, description="share of pixels that are dead")
    aged: Share = Field(0.0, description="share of pixels that have aged")
    aged_factor: Share = Field(0.5, description="remaining light of an aged pixel, relative to a new one")
    dead_pixels: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] = Field(
        (), description="numbers of dead pixels in each module, row by row from the upper left"
    )
    seed: Seed = Field(0, description="seed of the choice of pixels")

    @model_validator(mode="after")
    def _at_most_all(self) -> Self:
        if self.dead + self.aged > 1:
            raise ValueError(f"dead ({self.dead:g}) and aged ({self.aged:g}) are shares of all pixels; give at most 1 together")
        return self


class DisturbanceParams(Params):
    """Disturbances unknown to the controller."""

    oncoming: tuple[OncomingSpellParams, ...] = Field((), description="headlamps that face the camera")
    ambient: tuple[AmbientParams, ...] = Field((), description="changes of the light beside the headlamps'; several multiply")
    noise: tuple[NoiseParams, ...] = Field((), description="more noise; several multiply")
    drops: tuple[DropsParams, ...] = Field((), description="lost frames")
    lens: tuple[LensParams, ...] = Field((), description="dirt or ice on the camera's lens, one layer after the other")
    calibration: CalibrationParams = Field(CalibrationParams(), description="error of the camera's calibration")
    aim: tuple[AimParams, ...] = Field((), description="errors of the lamps' aim; several add up")
    wear: WearParams = Field(WearParams(), description="dead and aged pixels of the lamps")

    cover: SoilingParams = Field(SoilingParams(), description="dirt or ice on the lamps' covers")

    def ambient_factor(self, step: int, frame: int) -> float:
        """Light beside the headlamps' in a step's on frame (0) or off frame (1), as a multiple of the scenario's."""
        return math.prod(each.factor for each in self.ambient if each.holds_in(step, frame))

    def noise_factor(self, step: int) -> float:
        """Noise in a step's frames, as a multiple of the camera's."""
        return math.prod(each.factor for each in self.noise if each.holds(step))

    def oncoming_in(self, step: int, frame: int) -> Iterable[OncomingParams]:
        """Headlamps that face the camera in a step's on frame (0) or off frame (1)."""
        return (each for each in self.oncoming if each.holds_in(step, frame))

    def lens_in(self, step: int) -> tuple[SoilingParams, ...]:
        """What soils the camera's lens in a step."""
        return tuple(each for each in self.lens if each.holds(step))

    def loss_probability(self, step: int, always: float) -> float:
        """Probability that a step's frames are lost. always: the camera's own probability."""
        return 1 - (1 - always) * math.prod(1 - each.probability for each in self.drops if each.holds(step))


UNDISTURBED = DisturbanceParams()
