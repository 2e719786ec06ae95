"""Glare-free high beam: the boxes of other road users stay dark (T 3.5.1, 7.2.2)."""

import math
from itertools import pairwise
from typing import Literal, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor

from controllers.geometry import cuboid
from controllers.pixels.primitives import Primitives, rectangle
from controllers.situation import LAYERS, MASK, SelectionParams, Situation, TrackedObject, fade
from perception.tracking import LINGER_S
from world.frames import inverse, transform
from world.params import Params

FADING = 1e6  # weight of a mask that fades: beats all but masks that do not, which an infinite one would be averaged with
CLEARANCE = 0.8  # share of the gap between a box and a lamp beside it that a margin may take


class SoftZoneParams(Params):
    """A larger box that is dimmed only."""

    margin_m: float = Field(gt=0, le=10_000, description="how much larger it is to each side than the mask")
    u_rel: float = Field(ge=0, le=1, description="what is left of the base beam in it")


class GlareFreeParams(SelectionParams):
    """No light on other road users."""

    kind: Literal["glare_free"] = "glare_free"
    margin_m: float = Field(0.2, ge=0, le=10_000, description="safety margin around the box, except below its foot")
    margin_deg: float = Field(0.2, ge=0, le=5, description="the same as an angle seen from the lamps, in addition")
    fade_in_s: float = Field(0.0, ge=0, le=1e6, description="time to go dark for a new object; 0 goes dark at once, which is safe")
    fade_out_s: float = Field(0.6, ge=0, le=LINGER_S, description="time to become bright again behind an object that is gone")
    soft_zones: tuple[SoftZoneParams, ...] = Field((), max_length=LAYERS - 1, description="dimmed boxes around the mask, inner ones first")

    @model_validator(mode="after")
    def _inner_zones_first(self) -> Self:
        margins = [zone.margin_m for zone in self.soft_zones]
        if any(outer <= inner for inner, outer in pairwise(margins)):
            raise ValueError(f"soft_zones: margin_m must ascend, or inner zones hide outer ones, here {margins}; put the smallest first")
        return self

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """A cuboid of six outward primitives for each object, forced and of infinite weight, and one for each soft zone.

        What fades gives light again, so it yields to all that is still dark: it is of finite weight and less priority.
        """
        return tuple(part for each in self.selected(now) for part in self._around(each, now))

    def _around(self, each: TrackedObject, now: Situation) -> tuple[Primitives, ...]:
        share = fade(now.time_s, each.since_s, each.until_s, self.fade_in_s, self.fade_out_s)
        if share == 0:
            return ()
        T, lamps = each.T_world_object, now.lamps
        distance = float((T[:3, 3] - lamps.to(T)).norm(dim=-1).amin())
        margin = self.margin_m + distance * math.tan(math.radians(self.margin_deg))
        mask = cuboid(T, *enlarged(each, margin, lamps))
        dark = share == 1
        quantity: Literal["u_abs", "u_rel"] = "u_abs" if dark else "u_rel"
        weight, priority = math.inf if dark else FADING, (MASK + dark) * LAYERS + LAYERS - 1
        parts = [rectangle(*mask, 1 - share, quantity, weight=weight, forced=True, priority=priority)]
        for layer, zone in enumerate(self.soft_zones, 1):
            box = cuboid(T, *enlarged(each, margin + zone.margin_m, lamps))
            parts.append(rectangle(*box, 1 - share * (1 - zone.u_rel), "u_rel", forced=True, priority=MASK * LAYERS + LAYERS - 1 - layer))
        return tuple(parts)


def enlarged(each: TrackedObject, margin_m: float, lamps: Tensor) -> tuple[Tensor, Tensor]:
    """Corners `[3]` m in the object's frame of its box with a margin to all sides but the foot, which stays: below is the road to be lit.

    lamps: `[L, 3]` m. A box around a lamp would have only back faces, which mask nothing, so on the side on which a lamp is farthest
    from the box the margin ends before it.
    """
    length, width, height = each.size_m
    low, high = torch.tensor([[-length / 2, -width / 2, 0.0], [length / 2, width / 2, height]], dtype=torch.float64)
    margins_low, margins_high = torch.tensor([[margin_m, margin_m, 0.0], [margin_m] * 3], dtype=torch.float64)
    for lamp in transform(inverse(each.T_world_object.double()), lamps.double().T).T:
        below, above = low - lamp, lamp - high
        gap, axis = torch.cat([below, above]).max(dim=0)
        side, k = divmod(int(axis), 3)
        margins = margins_high if side else margins_low
        margins[k] = torch.minimum(margins[k], CLEARANCE * gap.clamp(min=0))
    return low - margins_low, high + margins_high
