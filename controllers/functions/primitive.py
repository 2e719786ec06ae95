"""A primitive by itself: a rectangle of light on the road, upright or anywhere else (T 3.5.2, 4.2.2, 7.2.1)."""

from typing import Final, Literal

import torch
from pydantic import Field

from luxloop.controllers.functions.animations import Animated, AnimationParams
from luxloop.controllers.geometry import Place
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import DrawingParams, Situation
from luxloop.world.frames import pose_from_degrees
from luxloop.world.symbols import Still

WHITE: Final = Still(torch.ones(1, 1))


class PrimitiveParams(DrawingParams):
    """Draws a rectangle at any place and in any attitude.

    Its own frame is x along its length, to the image's first row, y to the left across its width, and z out of the side that takes light.
    """

    kind: Literal["primitive"] = "primitive"
    image: str | None = Field(
        None, description="name of a shipped symbol, or path of a picture, SVG, video or folder of pictures; left out: even light"
    )
    x_m: float = Field(17.0, ge=-10_000, le=10_000, description="position of the centre ahead of the car")
    y_m: float = Field(0.0, ge=-10_000, le=10_000, description="lateral position of the centre, left positive")
    z_m: float = Field(0.0, ge=-10_000, le=10_000, description="height of the centre above the road's plane")
    roll_deg: float = Field(0.0, ge=-180, le=180, description="rotation about its length, right side down")
    pitch_deg: float = Field(0.0, ge=-90, le=90, description="rotation about its width: 0 on the road, -90 upright and facing the car")
    yaw_deg: float = Field(0.0, ge=-180, le=180, description="rotation to the left")
    width_m: float = Field(2.0, gt=0, le=10_000, description="extent across")
    length_m: float = Field(4.0, gt=0, le=10_000, description="extent along")
    animation: AnimationParams | None = Field(None, description="animation; left out: none but that of a video itself")

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """One primitive; none while it is not active or its animation is off."""
        if not self.active(now):
            return ()
        source = WHITE if self.image is None else now.symbols[self.image]
        time_s = now.time_s - (self.start_s or 0.0)
        if self.animation:
            source = Animated(source, self.animation)
            if not source.shows(time_s):
                return ()
        return (self.draw(self._place(now), source.at(time_s)),)

    def _place(self, now: Situation) -> Place:
        T = now.T_world_vehicle.double() @ pose_from_degrees((self.x_m, self.y_m, self.z_m), self.roll_deg, self.pitch_deg, self.yaw_deg)
        ahead, left, out, centre = T[:3].unbind(-1)
        d1, d2 = -self.width_m * left, -self.length_m * ahead
        return Place(centre - (d1 + d2) / 2, d1, d2, out)
