"""Light for tracked objects: glare-free high beam, sign dimming and markers (T 3.5.1, 7.2.2)."""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Literal, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.functions.animations import WHITE, AnimationParams, animate
from luxloop.controllers.geometry import Place, cuboid, facing, strip
from luxloop.controllers.pixels.primitives import Primitives, rectangle
from luxloop.controllers.situation import (
    LAYERS,
    SOFT_MASK,
    SURE,
    Category,
    DrawingParams,
    Priority,
    SelectionParams,
    Situation,
    TrackedObject,
    check_share,
    fade,
)
from luxloop.perception.tracking import LINGER_S
from luxloop.world.frames import inverse, transform
from luxloop.world.params import Distance, Length, NotNegative, Params, PositiveShare, Share
from luxloop.world.traffic.tracked import ROAD_USERS

FADING = 1e6  # weight of a fading mask: above all finite weights; full masks have infinite weight and are not averaged with it
PROBE_LX = 0.3  # in the mask of an object of low confidence, or of one that hides a tracked road user: a detector finds them, no glare
CLEARANCE = 0.8  # largest share of the gap between box and lamp for a margin


class SoftZoneParams(Params):
    """A larger box around the mask in which the base beam is dimmed."""

    margin_m: Length = Field(examples=[0.5], description="margin beyond the mask on each side")
    u_rel: Share = Field(examples=[0.3], description="share of the base beam that remains in the zone")


class GlareFreeParams(SelectionParams):
    """Keeps light off other road users."""

    kind: Literal["glare_free"] = "glare_free"
    margin_m: Distance = Field(0.2, description="safety margin around the box, except below its foot")
    margin_deg: float = Field(0.2, ge=0, le=5, description="additional margin as an angle seen from the lamps")
    fade_in_s: NotNegative = Field(0.0, description="time until a new object is dark; 0 is immediate and safe")
    fade_out_s: float = Field(0.6, ge=0, le=LINGER_S, description="time until full light returns where an object has vanished")
    soft_zones: tuple[SoftZoneParams, ...] = Field((), max_length=LAYERS - 1, description="dimmed boxes around the mask, inner ones first")

    @model_validator(mode="after")
    def _inner_zones_first(self) -> Self:
        margins = [zone.margin_m for zone in self.soft_zones]
        if any(outer <= inner for inner, outer in pairwise(margins)):
            raise ValueError(f"soft_zones: margin_m must ascend, here {margins}; put the smallest first")
        return self

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """A cuboid of six outward primitives for each object, forced and of infinite weight, and one cuboid for each soft zone.

        A fading mask lets light through again and must yield to full masks, so its weight is finite and its priority lower. Full masks
        yield to the light on nearer objects. They let PROBE_LX through if they may hide a tracked road user who is not masked. Objects that
        object light lights have no mask: that function keeps their heads dark.
        """
        masked = [each for each in self.select(now) if each.name not in now.lit]
        users = [each for each in now.objects if each.category in ROAD_USERS and each.present(now.time_s)]
        others = [each for each in users if each.confidence < 1 and each not in masked]  # by a detector, not by the truth
        return tuple(part for each in masked for part in self._around(each, others, now))

    def _around(self, each: TrackedObject, others: Sequence[TrackedObject], now: Situation) -> tuple[Primitives, ...]:
        share = fade(now.time_s, each.since_s, each.until_s, self.fade_in_s, self.fade_out_s)
        if share == 0:
            return ()
        T, lamps = each.T_world_object, now.lamps
        distance = float((T[:3, 3] - lamps.to(T)).norm(dim=-1).amin())
        margin = self.margin_m + distance * math.tan(math.radians(self.margin_deg))
        low, high = extend_box(each, margin, lamps)
        mask, soft = cuboid(T, low, high), SOFT_MASK * LAYERS + LAYERS - 1
        if share == 1:
            probe = 1.0 if any(overlap(T, low, high, other, lamps) for other in others) else min((1 - each.confidence) / (1 - SURE), 1.0)
            probe_cd = probe * PROBE_LX * max(distance - each.size_m[0] / 2, 1.0) ** 2
            parts = [rectangle(*mask, probe_cd, "I_v", weight=math.inf, forced=True, priority=now.mask_layer(each) + LAYERS - 1)]
        else:
            parts = [rectangle(*mask, 1 - share, "u_rel", weight=FADING, forced=True, priority=soft)]
        for layer, zone in enumerate(self.soft_zones, 1):
            box = cuboid(T, *extend_box(each, margin + zone.margin_m, lamps))
            parts.append(rectangle(*box, 1 - share * (1 - zone.u_rel), "u_rel", forced=True, priority=soft - layer))
        return tuple(parts)


def extend_box(each: TrackedObject, margin_m: float, lamps: Tensor) -> tuple[Tensor, Tensor]:
    """Two opposite corners `[3]` m, in the object's frame, of its box with a margin on all sides but the foot: the road below stays lit.

    lamps: positions `[L, 3]` m. A box around a lamp would show it only back faces, which mask nothing, so the margin ends before the lamp,
    on the side of the greatest distance.
    """
    low, high = each.bounds
    margins_low, margins_high = torch.tensor([[margin_m, margin_m, 0.0], [margin_m] * 3], dtype=torch.float64)
    for lamp in transform(inverse(each.T_world_object.double()), lamps.double().T).T:
        below, above = low - lamp, lamp - high
        gap, axis = torch.cat([below, above]).max(dim=0)
        side, k = divmod(int(axis), 3)
        margins = margins_high if side else margins_low
        margins[k] = torch.minimum(margins[k], CLEARANCE * gap.clamp(min=0))
    return low - margins_low, high + margins_high


def overlap(T_world_box: Tensor, low: Tensor, high: Tensor, other: TrackedObject, lamps: Tensor) -> bool:
    """Whether a box with opposite corners low and high `[3]` m and an object have a common azimuth seen from a lamp at `[L, 3]` m."""
    first, last = (_azimuths(T, corners, lamps) for T, corners in ((T_world_box, (low, high)), (other.T_world_object, other.bounds)))
    return bool(((first[0] <= last[1]) & (last[0] <= first[1])).any())


def _azimuths(T_world_box: Tensor, corners: Iterable[Tensor], lamps: Tensor) -> tuple[Tensor, Tensor]:
    """Smallest and largest azimuth `[L]` in rad of a box ahead of lamps at `[L, 3]` m. corners: two opposite ones, `[3]` m."""
    points = transform(T_world_box.double(), torch.cartesian_prod(*torch.stack([*corners]).T).T)
    x, y, _ = (points[:, None] - lamps.double().T[..., None]).unbind()
    return torch.atan2(y, x).aminmax(dim=-1)


class SignParams(SelectionParams):
    """Sets the light on traffic signs, to dim the signs or keep them readable."""

    kind: Literal["sign"] = "sign"
    categories: tuple[Category, ...] = Field(("sign",), min_length=1, description="classes of objects to dim")
    quantity: Literal["E_v", "u_abs", "u_rel"] = Field(
        "u_rel", description="unit of the setpoint: u_rel, share of the base beam; u_abs, utilisation; E_v, lx on the sign"
    )
    value: float = Field(0.2, ge=0, le=1e9, description="setpoint")
    weight: NotNegative = Field(1.0, description="weight against other light where a pixel lights more than the sign")
    priority: Priority = 50
    margin_m: Distance = Field(0.1, description="margin of the primitive beyond the sign on each side")

    @model_validator(mode="after")
    def _share_of_a_pixel(self) -> Self:
        check_share(self.quantity, self.value)
        return self

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """One forced primitive in the face of each sign, facing the car."""
        return tuple(self._face(each, now) for each in self.select_present(now))

    def _face(self, each: TrackedObject, now: Situation) -> Primitives:
        low, high = each.bounds + self.margin_m * torch.tensor([[0.0, -1.0, -1.0], [0.0, 1.0, 1.0]]).double()
        T = each.T_world_object.double()
        origin, d1, d2 = cuboid(T, low, high)
        ahead = (now.lamps.mean(0).to(T) - T[:3, 3]) @ T[:3, 0] >= 0
        face = 0 if ahead else 1  # the faces across x
        return rectangle(
            origin[face], d1[face], d2[face], self.value, self.quantity, weight=self.weight, forced=True, priority=self.priority * LAYERS
        )


SHORTEST_M = 0.5  # shorter lines are not drawn


class MarkerParams(DrawingParams, SelectionParams):
    """Directs the driver's attention to an object."""

    kind: Literal["marker"] = "marker"
    categories: tuple[Category, ...] = Field(("pedestrian", "animal"), min_length=1, description="classes of objects to mark")
    target: Literal["road", "body"] = Field("road", description="`road`: a line towards the object; `body`: light on the object")
    width_m: Length = Field(0.25, description="width of the line")
    near_m: Length = Field(8.0, description="where the line starts, ahead of the lamps")
    gap_m: Distance = Field(0.5, description="distance from the end of the line to the object")
    up_to: PositiveShare = Field(0.6, description="share of the body's height that is lit, from the feet up, to avoid dazzling")
    surround_m: Distance = Field(0.0, description="width of the dimmed surround on each side of the line, for contrast")
    surround_u_rel: Share = Field(0.3, description="share of the base beam that remains in the surround")
    animation: AnimationParams | None = Field(None, description="animation; left out: none")

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        if not self.active(now) or (image := animate(WHITE, self.animation, now.time_s)) is None:
            return ()
        marked = self.select_present(now)
        if self.target == "road":
            return tuple(part for each in marked for part in self._line(each, image, now))
        return tuple(self.draw(self._body(each, now), image, layer=1) for each in marked)

    def _line(self, each: TrackedObject, image: Tensor, now: Situation) -> tuple[Primitives, ...]:
        foot = transform(inverse(now.T_world_vehicle), each.T_world_object[:3, 3:].to(now.T_world_vehicle))[:2, 0]
        way = foot / foot.norm()
        start, stop = self.near_m * way, (now.distance_m(each) - self.gap_m) * way
        if (stop - start) @ way < SHORTEST_M:
            return ()
        line = self.draw(strip(now.T_world_vehicle, start, stop, self.width_m), image, layer=1)
        if not self.surround_m:
            return (line,)
        around = strip(now.T_world_vehicle, start, stop, self.width_m + 2 * self.surround_m)
        dimmed = self.model_copy(update={"quantity": "u_rel", "value": self.surround_u_rel, "weight": 1.0})
        return line, dimmed.draw(around)

    def _body(self, each: TrackedObject, now: Situation) -> Place:
        bounds = each.bounds
        bounds[1, 2] *= self.up_to
        return facing(each.T_world_object, bounds, now.lamps.mean(0))
