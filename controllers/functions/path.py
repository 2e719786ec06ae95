"""Light along curves on the road: paths, symbols bent along them, lane borders (T B.2)."""

import math
from functools import lru_cache
from typing import Literal, Self

import cv2
import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.functions.bezier import closest, derivative, length_at, point
from luxloop.controllers.geometry import Place, on_road
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import DrawingParams, Situation
from luxloop.world.params import Metres

Point = tuple[float, float]
MOST_TEXELS = 1e7  # limit of a drawing: 250 m x 100 m at 5 cm


class PathParams(DrawingParams):
    """A Bezier curve on the road, drawn as a band or as a symbol repeated and bent along it."""

    kind: Literal["path"] = "path"
    control_m: tuple[tuple[Metres, Metres], ...] = Field(
        min_length=2,
        max_length=12,
        examples=[[[6.0, 0.0], [40.0, 3.0]]],
        description="control points, x ahead and y left, from the car outward",
    )
    width_m: float = Field(1.0, gt=0, le=10_000, description="width of the band")
    image: str | None = Field(None, description="symbol bent along the curve, its far end ahead; left out: an even band")
    image_length_m: float = Field(3.0, gt=0, le=10_000, description="length of one symbol along the curve")
    image_pitch_m: float = Field(4.0, gt=0, le=10_000, description="spacing from one symbol to the next")
    speed_m_s: float = Field(0.0, ge=-200, le=200, description="speed of the symbols along the curve")
    texel_m: float = Field(0.05, gt=0, le=1, description="resolution of the drawing")

    @model_validator(mode="after")
    def _has_a_length_and_a_small_drawing(self) -> Self:
        ahead, left = zip(*self.control_m, strict=True)
        if max(ahead) == min(ahead) and max(left) == min(left):
            raise ValueError("control_m: all points coincide, so the path has no length; move the last one")
        texels = math.prod((max(at) - min(at) + self.width_m) / self.texel_m for at in (ahead, left))
        if texels > MOST_TEXELS:
            raise ValueError(f"control_m: the curve's drawing would have {texels:.1e} texels, not {MOST_TEXELS:.0e}; raise texel_m")
        return self

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        if not self.active(now):
            return ()
        drawing = drawn(self.control_m, self.width_m / 2, self.texel_m)
        place = drawing.place(now.T_world_vehicle)
        if self.image is None:
            return (self.draw(place, opacity=drawing.band(self.width_m / 2)),)
        shift = self.speed_m_s * now.time_s
        image = drawing.bent(now.symbols[self.image].at(now.time_s), self.width_m, self.image_length_m, self.image_pitch_m, shift)
        return (self.draw(place, image, opacity=drawing.band(self.width_m / 2, 0.0)),)


@lru_cache(maxsize=16)
def drawn(control_m: tuple[Point, ...], reach_m: float, texel_m: float) -> "Drawing":
    """Cached, since every step asks for the same curve."""
    return Drawing(torch.tensor(control_m, dtype=torch.float64), reach_m, texel_m)


class Drawing:
    """Texels of a rectangle on the road around a curve, each with its closest point on the curve.

    low: `[2]` m, the corner with the least x and y. shape: rows, columns. distance: `[h, w]` m, signed, positive to the left of the curve.
    along: `[h, w]` m, arc length of the closest point. beyond: `[h, w]` m, distance before the start or after the end. nearest: `[h, w]` m,
    distance to the curve including its ends (T eq. B.2.2); infinite for texels out of reach.
    """

    def __init__(self, control: Tensor, reach_m: float, texel_m: float) -> None:
        """All texels that are closer than reach_m to the curve; control: `[n + 1, 2]` m, x ahead and y left."""
        curve = point(control, torch.linspace(0, 1, 257).to(control))
        margin = reach_m + 2 * texel_m
        low, high = curve.amin(0) - margin, curve.amax(0) + margin
        rows, cols = shape = tuple(((high - low) / texel_m).ceil().long().tolist())
        self.low, self.shape, self.texel_m = low, shape, texel_m
        x = low[0] + (rows - 0.5 - torch.arange(rows).to(control)) * texel_m  # row 0 is farthest ahead
        y = low[1] + (cols - 0.5 - torch.arange(cols).to(control)) * texel_m  # column 0 is farthest to the left
        texels = torch.stack([x[:, None].expand(shape), y.expand(shape)], -1)
        # A thick stroke finds the few texels that are near: a search for the closest point of every texel would take most of the time.
        stroke = ((curve - low) / texel_m).flip(-1).round().int().numpy()
        painted = cv2.polylines(np.zeros(shape, np.uint8), [stroke], False, 1, thickness=2 * math.ceil(margin / texel_m) + 1)
        near = torch.from_numpy(np.asarray(painted, bool)).flip(0, 1)
        texels = texels[near]
        t, distance = closest(control, texels)
        slope = point(derivative(control), t)
        tangent = torch.nn.functional.normalize(slope, dim=-1)
        away = texels - point(control, t)
        left = tangent[..., 0] * away[..., 1] - tangent[..., 1] * away[..., 0]

        def image(values: Tensor, elsewhere: float = 0.0) -> Tensor:
            return control.new_full(shape, elsewhere).masked_scatter(near, values)

        self.nearest = image(distance, math.inf)
        self.distance = image(left)
        self.along = image(length_at(control, t))
        self.beyond = image((away * tangent).sum(-1).abs(), math.inf)

    def place(self, T_world_vehicle: Tensor) -> Place:
        """The rectangle on the road that holds the drawing."""
        length, width = (n * self.texel_m for n in self.shape)
        corner = self.low + self.low.new_tensor([length, width])
        return on_road(T_world_vehicle, corner, corner.new_tensor([0.0, -width]), corner.new_tensor([-length, 0.0]))

    def band(self, half_width_m: float, offset_m: float | None = None) -> Tensor:
        """A band `[h, w]` in 0..1 along the curve, with round ends; with offset_m, its centre line lies so far to the left and its ends are
        straight.

        The edges are soft over one texel.
        """
        if offset_m is None:
            return self._soft(half_width_m - self.nearest)
        return self._soft(torch.minimum(half_width_m - (self.distance - offset_m).abs(), self.texel_m / 2 - self.beyond))

    def bent(self, image: Tensor, width_m: float, length_m: float, pitch_m: float, shift_m: float = 0.0) -> Tensor:
        """An image `[h, w]` bent along the curve, last row first, repeated every pitch_m and shifted along by shift_m."""
        place = (self.along - shift_m) % pitch_m
        u, v = 0.5 - self.distance / width_m, 1 - place / length_m
        grid = torch.stack([2 * u - 1, 2 * v - 1], -1)[None]
        bent = torch.nn.functional.grid_sample(image[None, None].to(grid), grid, padding_mode="zeros", align_corners=False)[0, 0]
        return bent * ((v >= 0) & (u >= 0) & (u <= 1) & (self.beyond < self.texel_m / 2))

    def _soft(self, inside_m: Tensor) -> Tensor:
        return (0.5 + inside_m / self.texel_m).clamp(0, 1)
