"""Light along curves on the road: Bezier curves, bands and symbols along them, the lane, the car's width (T 3.5.2, B.2)."""

import math
from functools import lru_cache
from math import comb
from typing import Literal, Self

import cv2
import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.geometry import Place, on_road, strip
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import DrawingParams, Situation
from luxloop.world.params import Length, Metres, in_order

HALLEY_STEPS = 6  # from the best sample, Halley's cubic convergence needs three or four
SAMPLES_PER_DEGREE = 64  # dense, since near a cusp the closest point may lie between two samples that are not the closest
INTERVALS, NODES = 32, 8  # of the arc length's quadrature: error about 1e-9 of the length for curves without a cusp


def point(control: Tensor, t: Tensor) -> Tensor:
    """Curve points `[..., N, D]` at parameters `[..., N]` in 0..1 (T eq. B.2.1). control: control points `[..., n + 1, D]`, in any unit."""
    n = control.shape[-2] - 1
    power = torch.arange(n + 1, device=control.device)
    binomial = torch.tensor([comb(n, i) for i in range(n + 1)]).to(control)
    return (binomial * (1 - t[..., None]) ** (n - power) * t[..., None] ** power) @ control


def derivative(control: Tensor) -> Tensor:
    """Control points `[..., max(n, 1), D]` of the curve's derivative, itself a Bezier curve."""
    n = control.shape[-2] - 1
    return n * control.diff(dim=-2) if n else torch.zeros_like(control)


def length_at(control: Tensor, t: Tensor) -> Tensor:
    """Arc length `[..., N]` from the start to the parameters `[..., N]` in 0..1, by Gauss-Legendre quadrature piece by piece."""
    knots = torch.linspace(0, 1, INTERVALS + 1).to(control)
    piece = (t.detach() * INTERVALS).long().clamp(0, INTERVALS - 1)
    whole = _arc(control, knots[:-1], knots[1:]).cumsum(-1)
    before = torch.nn.functional.pad(whole, (1, 0)).expand(*t.shape[:-1], -1).gather(-1, piece)
    return before + _arc(control, knots[piece], t)


def closest(control: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Parameter and distance, both `[..., N]`, of the curve's point that is closest to each of `points` `[..., N, D]` (T eq. B.2.3, B.2.4).

    Halley's method starts at the best of several samples, both ends included, and stays between its neighbours, since it may otherwise run
    to a maximum. The better of result and sample is returned.
    """
    n = control.shape[-2] - 1
    samples = torch.linspace(0, 1, SAMPLES_PER_DEGREE * max(n, 1) + 1).to(control)
    t = samples[torch.cdist(points, point(control, samples)).argmin(-1)]
    step = 1 / (len(samples) - 1)
    low, high = (t - step).clamp(min=0), (t + step).clamp(max=1)
    curves = [control]
    for _ in range(3):
        curves.append(derivative(curves[-1]))
    best, nearest = t, _distance2(control, t, points)
    for _ in range(HALLEY_STEPS):
        b, b1, b2, b3 = (point(curve, t) for curve in curves)
        away = b - points
        f1 = (away * b1).sum(-1)
        f2 = (b1 * b1 + away * b2).sum(-1)
        f3 = (3 * b1 * b2 + away * b3).sum(-1)
        slope = 2 * f2 * f2 - f1 * f3  # T eq. B.2.4; f1, f2, f3 are half the derivatives of T eq. B.2.3, [..., N]
        t = (t - torch.where(slope == 0, 0.0, 2 * f1 * f2 / torch.where(slope == 0, 1.0, slope))).clamp(low, high)
        squared = _distance2(control, t, points)
        closer = squared < nearest
        best, nearest = torch.where(closer, t, best), torch.where(closer, squared, nearest)
    return best, nearest.sqrt()


def _distance2(control: Tensor, t: Tensor, points: Tensor) -> Tensor:
    return (point(control, t) - points).square().sum(-1)


def _arc(control: Tensor, start: Tensor, stop: Tensor) -> Tensor:
    """Length `[..., N]` of the curve from parameters `[..., N]` to others."""
    nodes, weights = (torch.from_numpy(each).to(control) for each in np.polynomial.legendre.leggauss(NODES))
    half = ((stop - start) / 2)[..., None]
    t = start[..., None] + half * (nodes + 1)
    speed = point(derivative(control), t.flatten(-2)).norm(dim=-1).unflatten(-1, t.shape[-2:])
    return (speed * weights * half).sum(-1)


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
    width_m: Length = Field(1.0, description="width of the band")
    image: str | None = Field(None, description="symbol bent along the curve, its far end ahead; left out: an even band")
    image_length_m: Length = Field(3.0, description="length of one symbol along the curve")
    image_pitch_m: Length = Field(4.0, description="spacing from one symbol to the next")
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
        drawing = cached_drawing(self.control_m, self.width_m / 2, self.texel_m)
        place = drawing.place(now.T_world_vehicle)
        if self.image is None:
            return (self.draw(place, opacity=drawing.band(self.width_m / 2)),)
        shift = self.speed_m_s * now.time_s
        image = drawing.bent(now.symbols[self.image].at(now.time_s), self.width_m, self.image_length_m, self.image_pitch_m, shift)
        return (self.draw(place, image, opacity=drawing.band(self.width_m / 2, 0.0)),)


@lru_cache(maxsize=16)
def cached_drawing(control_m: tuple[Point, ...], reach_m: float, texel_m: float) -> "Drawing":
    """The drawing of a curve; cached, since a run draws few curves many times."""
    return Drawing(torch.tensor(control_m, dtype=torch.float64), reach_m, texel_m)


class Drawing:
    """Texels of a rectangle on the road around a curve, each with its closest point on the curve.

    low: `[2]` m, the corner with the least x and y. shape: rows, columns. distance: `[h, w]` m, signed, positive to the left of the curve.
    along: `[h, w]` m, arc length of the closest point. beyond: `[h, w]` m, distance before the start or after the end. nearest: `[h, w]` m,
    distance to the curve including its ends (T eq. B.2.2); infinite for texels out of reach.
    """

    def __init__(self, control: Tensor, reach_m: float, texel_m: float) -> None:
        """Compute all texels within reach_m of a curve. control: `[n + 1, 2]` m, x ahead and y left."""
        curve = point(control, torch.linspace(0, 1, 257).to(control))
        margin = reach_m + 2 * texel_m
        low, high = curve.amin(0) - margin, curve.amax(0) + margin
        rows, cols = shape = tuple(((high - low) / texel_m).ceil().long().tolist())
        self.low, self.shape, self.texel_m = low, shape, texel_m
        x = low[0] + (rows - 0.5 - torch.arange(rows).to(control)) * texel_m  # row 0 is farthest ahead
        y = low[1] + (cols - 0.5 - torch.arange(cols).to(control)) * texel_m  # column 0 is farthest to the left
        texels = torch.stack([x[:, None].expand(shape), y.expand(shape)], -1)
        # A thick stroke selects the few near texels; a search for every texel would take most of the time.
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
        """A band `[h, w]` in 0..1 along the curve, with round ends. offset_m: offset of the centre line to the left; then with straight
        ends.

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


QUARTER_TURN = math.pi / 2  # rad, the largest arc that one cubic curve approximates
STRAIGHT_1_M = 1e-5  # a curve of less curvature leaves its tangent by 2 cm in 60 m


class Stretch(DrawingParams):
    """A drawing on the road between two distances ahead."""

    near_m: Metres = Field()
    far_m: Metres = Field()

    _range_in_order = in_order("near_m", "far_m")


class LaneParams(Stretch):
    """A carpet of light on the lane, or a line along each of its borders, bent like the car's course."""

    kind: Literal["lane"] = "lane"
    style: Literal["carpet", "lines"] = Field("carpet", description="`carpet` fills the lane, `lines` marks its borders")
    lane_width_m: Length = Field(2.6, description="width of the carpet, or distance between the centres of the lines")
    line_width_m: Length = Field(0.2, description="width of a line")
    near_m: Length = Field(6.0, description="start of the light, ahead of the car")
    far_m: Length = Field(40.0, description="end of the light; in a tight bend at most a quarter turn")
    y_m: Metres = Field(0.0, description="lateral position of the lane's centre at the car, left positive")
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
    vehicle_width_m: Length = Field(2.1, description="distance between the outer edges of the lines: the car's width with mirrors")
    line_width_m: Length = Field(0.15, description="width of a line")
    near_m: Length = Field(5.0, description="start of the lines, ahead of the car")
    far_m: Length = Field(25.0, description="end of the lines")

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
