"""Marker light: a line on the road that leads to an object, or light on the object itself (T 3.5.1, 7.2.2)."""

from typing import Literal

import torch
from pydantic import Field

from controllers.functions.animations import Animated, AnimationParams
from controllers.geometry import Place, facing, strip
from controllers.pixels.primitives import Primitives
from controllers.situation import Category, Drawn, SelectionParams, Situation, TrackedObject
from world.frames import inverse, transform
from world.symbols import Still

SHORTEST_M = 0.5  # a shorter line leads nowhere
WHITE = Still(torch.ones(1, 1))


class MarkerParams(Drawn, SelectionParams):
    """Guides the driver's eye to an object."""

    kind: Literal["marker"] = "marker"
    categories: tuple[Category, ...] = Field(("pedestrian", "animal"), min_length=1, description="classes of objects meant")
    target: Literal["road", "body"] = Field("road", description="`road`: a line that leads to it; `body`: light on it")
    width_m: float = Field(0.25, gt=0, le=10_000, description="width of the line")
    near_m: float = Field(8.0, gt=0, le=10_000, description="where the line begins, ahead of the lamps")
    gap_m: float = Field(0.5, ge=0, le=10_000, description="how far before the object it ends")
    up_to: float = Field(0.6, gt=0, le=1, description="share of the body's height that is lit, from the foot, so that it does not dazzle")
    surround_m: float = Field(0.0, ge=0, le=10_000, description="how far beside the line the base beam is dimmed, for contrast")
    surround_u_rel: float = Field(0.3, ge=0, le=1, description="what is left of the base beam there")
    animation: AnimationParams | None = Field(None, description="how it changes with time; left out: it stands still")

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        if not self.active(now.time_s) or (self.animation and not Animated(WHITE, self.animation).shows(now.time_s)):
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
