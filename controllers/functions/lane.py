"""Optical lane assistant and width assistant: course of the lane, and width of the car (T 3.5.2)."""

import math
from typing import Literal, Self

import torch
from pydantic import Field, model_validator

from luxloop.controllers.functions.path import Drawing
from luxloop.controllers.geometry import strip
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import DrawingParams, Situation

QUARTER_TURN = math.pi / 2  # rad, the largest arc that one cubic curve approximates
STRAIGHT_1_M = 1e-5  # a curve of less curvature leaves its tangent by 2 cm in 60 m


class Stretch(DrawingParams):
    """A drawing on the road between two distances."""

    near_m: float = Field(ge=-10_000, le=10_000)
    far_m: float = Field(ge=-10_000, le=10_000)

    @model_validator(mode="after")
    def _far_is_beyond_near(self) -> Self:
        if self.far_m <= self.near_m:
            raise ValueError(f"far_m: {self.far_m:g} m is not beyond near_m = {self.near_m:g} m, so nothing would be drawn; raise it")
        return self


class LaneParams(Stretch):
    """A carpet of light on the lane, or a line along each of its borders, bent like the car's course."""

    kind: Literal["lane"] = "lane"
    style: Literal["carpet", "lines"] = Field("carpet", description="`carpet` fills the lane, `lines` marks its borders")
    lane_width_m: float = Field(2.6, gt=0, le=10_000, description="width of the carpet, or distance between the centres of the lines")
    line_width_m: float = Field(0.2, gt=0, le=10_000, description="width of a line")
    near_m: float = Field(6.0, gt=0, le=10_000, description="where it starts, ahead of the car")
    far_m: float = Field(40.0, gt=0, le=10_000, description="where it ends; in a tight bend it ends after a quarter turn")
    y_m: float = Field(0.0, ge=-10_000, le=10_000, description="lateral position of the lane's centre at the car, left positive")
    texel_m: float = Field(0.1, gt=0, le=1, description="resolution of the drawing in a bend")

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """Rectangles on a straight course; a drawing along a cubic curve in a bend."""
        if not self.active(now):
            return ()
        carpet = self.style == "carpet"
        offsets, width = ((0.0,), self.lane_width_m) if carpet else ((self.lane_width_m / 2, -self.lane_width_m / 2), self.line_width_m)
        if abs(now.curvature_1_m) < STRAIGHT_1_M:
            return tuple(straight(self, now, self.near_m, self.far_m, self.y_m + offset, width) for offset in offsets)
        far_m = min(self.far_m, self.near_m + QUARTER_TURN / abs(now.curvature_1_m))
        drawing = Drawing(arc(now.curvature_1_m, self.near_m, far_m, self.y_m), offsets[0] + width / 2, self.texel_m)
        lines = torch.stack([drawing.band(width / 2, offset) for offset in offsets]).amax(0)
        return (self.draw(drawing.place(now.T_world_vehicle), opacity=lines),)


class WidthParams(Stretch):
    """Two lines that show the car's width, for narrow passages."""

    kind: Literal["width"] = "width"
    vehicle_width_m: float = Field(
        2.1, gt=0, le=10_000, description="distance between the outer edges of the lines: the car's width with mirrors"
    )
    line_width_m: float = Field(0.15, gt=0, le=10_000, description="width of a line")
    near_m: float = Field(5.0, gt=0, le=10_000, description="where the lines begin, ahead of the car")
    far_m: float = Field(25.0, gt=0, le=10_000, description="where they end")

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        if not self.active(now):
            return ()
        y = (self.vehicle_width_m - self.line_width_m) / 2
        return tuple(straight(self, now, self.near_m, self.far_m, side * y, self.line_width_m) for side in (1, -1))


def straight(params: DrawingParams, now: Situation, near_m: float, far_m: float, y_m: float, width_m: float) -> Primitives:
    """One line along the car's axis."""
    start, stop = (torch.tensor([x, y_m], dtype=torch.float64) for x in (near_m, far_m))
    return params.draw(strip(now.T_world_vehicle, start, stop, width_m))


def arc(curvature_1_m: float, near_m: float, far_m: float, y_m: float = 0.0) -> torch.Tensor:
    """Control points `[4, 2]` m of a cubic Bezier curve that approximates the car's circular course between two arc lengths.

    Up to a quarter turn it deviates from the circle by less than 3e-4 of the radius.
    """
    angle = curvature_1_m * (far_m - near_m)
    reach = 4 / 3 * math.tan(angle / 4) / curvature_1_m

    def at(s: float) -> tuple[torch.Tensor, torch.Tensor]:
        heading = curvature_1_m * s
        place = torch.tensor([math.sin(heading), 1 - math.cos(heading)], dtype=torch.float64) / curvature_1_m
        return place + place.new_tensor([0.0, y_m]), torch.tensor([math.cos(heading), math.sin(heading)], dtype=torch.float64)

    (start, ahead), (stop, on) = at(near_m), at(far_m)
    return torch.stack([start, start + reach * ahead, stop - reach * on, stop])
