"""Marker light: a line on the road towards an object, or light on the object itself (T 3.5.1, 7.2.2)."""

from typing import Literal

import torch
from pydantic import Field

from luxloop.controllers.functions.animations import Animated, AnimationParams
from luxloop.controllers.geometry import Place, facing, strip
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import Category, DrawingParams, SelectionParams, Situation, TrackedObject
from luxloop.world.frames import inverse, transform
from luxloop.world.symbols import Still

SHORTEST_M = 0.5  # shorter lines are not drawn
WHITE = Still(torch.ones(1, 1))


class MarkerParams(DrawingParams, SelectionParams):
    """Directs the driver's attention to an object."""

    kind: Literal["marker"] = "marker"
    categories: tuple[Category, ...] = Field(("pedestrian", "animal"), min_length=1, description="classes of objects that it marks")
    target: Literal["road", "body"] = Field("road", description="`road`: a line towards the object; `body`: light on the object")
    width_m: float = Field(0.25, gt=0, le=10_000, description="width of the line")
    near_m: float = Field(8.0, gt=0, le=10_000, description="where the line starts, ahead of the lamps")
    gap_m: float = Field(0.5, ge=0, le=10_000, description="distance from the end of the line to the object")
    up_to: float = Field(0.6, gt=0, le=1, description="share of the body's height that is lit, from the feet up, to avoid dazzling")
    surround_m: float = Field(0.0, ge=0, le=10_000, description="width of the dimmed surround on each side of the line, for contrast")
    surround_u_rel: float = Field(0.3, ge=0, le=1, description="share of the base beam that remains in the surround")
    animation: AnimationParams | None = Field(None, description="animation; left out: none")

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        if not self.active(now) or (self.animation and not Animated(WHITE, self.animation).shows(now.time_s)):
            return ()
        present = (each for each in self.selected(now) if each.since_s <= now.time_s < each.until_s)
        return tuple(part for each in present for part in (self._line(each, now) if self.target == "road" else self._body(each, now)))

    def _line(self, each: TrackedObject, now: Situation) -> tuple[Primitives, ...]:
        foot = transform(inverse(now.T_world_vehicle), each.T_world_object[:3, 3:].to(now.T_world_vehicle))[:2, 0]
        way = foot / foot.norm()
        start, stop = self.near_m * way, (now.distance_m(each) - self.gap_m) * way
        if (stop - start) @ way < SHORTEST_M:
            return ()
        line = self._draw(strip(now.T_world_vehicle, start, stop, self.width_m), now)
        if not self.surround_m:
            return (line,)
        around = strip(now.T_world_vehicle, start, stop, self.width_m + 2 * self.surround_m)
        dimmed = self.model_copy(update={"quantity": "u_rel", "value": self.surround_u_rel, "weight": 1.0})
        return line, dimmed.draw(around)

    def _body(self, each: TrackedObject, now: Situation) -> tuple[Primitives, ...]:
        length, width, height = each.size_m
        low, high = torch.tensor([[-length / 2, -width / 2, 0.0], [length / 2, width / 2, self.up_to * height]], dtype=torch.float64)
        return (self._draw(facing(each.T_world_object, low, high, now.lamps.mean(0)), now),)

    def _draw(self, place: Place, now: Situation) -> Primitives:
        return self.draw(place, (Animated(WHITE, self.animation) if self.animation else WHITE).at(now.time_s), layer=1)
