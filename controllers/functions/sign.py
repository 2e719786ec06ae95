"""Sign dimming: less light on traffic signs, whose retroreflection dazzles the driver (T 3.5.1, 7.2.2)."""

from typing import Literal, Self

import torch
from pydantic import Field, model_validator

from luxloop.controllers.geometry import cuboid
from luxloop.controllers.pixels.primitives import Primitives, rectangle
from luxloop.controllers.situation import LAYERS, Category, SelectionParams, Situation, TrackedObject, check_share


class SignParams(SelectionParams):
    """Sets the light on traffic signs, to dim them or keep them readable."""

    kind: Literal["sign"] = "sign"
    categories: tuple[Category, ...] = Field(("sign",), min_length=1, description="classes of objects that it dims")
    quantity: Literal["E_v", "u_abs", "u_rel"] = Field(
        "u_rel", description="unit of the setpoint: u_rel, share of the base beam; u_abs, utilisation; E_v, lx on the sign"
    )
    value: float = Field(0.2, ge=0, le=1e9, description="setpoint")
    weight: float = Field(1.0, ge=0, le=1e6, description="weight against other light where a pixel lights more than the sign")
    priority: int = Field(50, ge=0, le=100, description="where functions overlap, the higher priority is drawn")
    margin_m: float = Field(0.1, ge=0, le=10_000, description="margin of the primitive beyond the sign on each side")

    @model_validator(mode="after")
    def _share_of_a_pixel(self) -> Self:
        check_share(self.quantity, self.value)
        return self

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """One forced primitive in the face of each sign, facing the car."""
        present = (each for each in self.selected(now) if each.since_s <= now.time_s < each.until_s)
        return tuple(self._face(each, now) for each in present)

    def _face(self, each: TrackedObject, now: Situation) -> Primitives:
        length, width, height = each.size_m
        m = self.margin_m
        low, high = torch.tensor([[-length / 2, -width / 2 - m, -m], [length / 2, width / 2 + m, height + m]], dtype=torch.float64)
        T = each.T_world_object.double()
        origin, d1, d2 = cuboid(T, low, high)
        ahead = (now.lamps.mean(0).to(T) - T[:3, 3]) @ T[:3, 0] >= 0
        face = 0 if ahead else 1  # the faces across x
        return rectangle(
            origin[face], d1[face], d2[face], self.value, self.quantity, weight=self.weight, forced=True, priority=self.priority * LAYERS
        )
