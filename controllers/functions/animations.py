"""Animations of symbols: blinking, running light, wipe (T 7.2.2, fig. 7.10)."""

import math
from typing import Annotated, Final, Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.params import NotNegative, Params, Positive, PositiveShare, Share
from luxloop.world.symbols import Still, SymbolSource

WHITE: Final = Still(torch.ones(1, 1))
Direction = Literal["away", "towards", "left", "right"]


class BlinkingParams(Params):
    """The symbol blinks."""

    kind: Literal["blinking"] = "blinking"
    rate_hz: float = Field(1.5, gt=0, le=20, description="blinks per second (UN R6 requires 1 to 2 for indicators)")
    duty: float = Field(0.5, gt=0, lt=1, description="share of each period during which it is on")

    def shows(self, time_s: float) -> bool:
        # A switching time may be rounded to just before it.
        return (time_s * self.rate_hz + 1e-6) % 1 < self.duty


class RunningLightParams(Params):
    """A bright band runs over the symbol repeatedly."""

    kind: Literal["running_light"] = "running_light"
    period_s: Positive = Field(1.0, description="time from one end to the other")
    length: PositiveShare = Field(0.3, description="length of the band, as a share of the symbol's length")
    rest: Share = Field(0.0, description="brightness of the symbol outside the band, as a share")
    direction: Direction = Field(
        "away", description="direction of the band: `away` from the driver, `towards` the driver, `left` or `right`"
    )

    def share(self, time_s: float, along: Tensor) -> Tensor:
        # The band enters at one border and leaves at the other; its cosine flanks have no steps.
        centre = (time_s / self.period_s) % 1 * (1 + self.length) - self.length / 2
        reach = ((along - centre) / self.length).clamp(-0.5, 0.5)
        return self.rest + (1 - self.rest) * (2 * math.pi * reach).cos().add(1) / 2


class WipeParams(Params):
    """The symbol is drawn from one end to the other and held, repeatedly."""

    kind: Literal["wipe"] = "wipe"
    draw_s: Positive = Field(0.8, description="time to draw it")
    hold_s: NotNegative = Field(0.7, description="time to hold it")
    softness: PositiveShare = Field(0.05, description="length of the soft front, as a share of the symbol's length")
    direction: Direction = Field(
        "away", description="direction of the front: `away` from the driver, `towards` the driver, `left` or `right`"
    )

    def share(self, time_s: float, along: Tensor) -> Tensor:
        drawn = min((time_s % (self.draw_s + self.hold_s)) / self.draw_s, 1.0)
        return ((drawn * (1 + self.softness) - along) / self.softness).clamp(0, 1)


AnimationParams = Annotated[BlinkingParams | RunningLightParams | WipeParams, Field(discriminator="kind")]


def animate(source: SymbolSource, animation: BlinkingParams | RunningLightParams | WipeParams | None, time_s: float) -> Tensor | None:
    """The image `[h, w]` in 0..1 of a symbol at a time; None while a blinking symbol is off, so that lower layers are visible.

    A homogeneous symbol is expanded to 64 x 64 texels, so that its brightness can vary.
    """
    image = source.at(time_s)
    if animation is None:
        return image
    if isinstance(animation, BlinkingParams):
        return image if animation.shows(time_s) else None
    image = image.expand(64, 64) if image.numel() == 1 else image
    return image * animation.share(time_s, _along(image, animation.direction))


def _along(image: Tensor, direction: Direction) -> Tensor:
    """Position of each texel in the direction of travel, 0 at the start and 1 at the end: `[h, 1]` or `[1, w]`."""
    rows, cols = image.shape
    if direction in ("left", "right"):
        along = ((torch.arange(cols).to(image) + 0.5) / cols)[None]
        return along if direction == "right" else 1 - along
    along = ((torch.arange(rows).to(image) + 0.5) / rows)[:, None]
    return along if direction == "towards" else 1 - along
