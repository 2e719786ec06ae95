"""Apparent position and size of an object from the lamps, to notice that it came nearer or that a new object is a lost one."""

import math
from dataclasses import dataclass
from typing import Self

from torch import Tensor

from luxloop.controllers.obl.light import NEAREST_M
from luxloop.controllers.situation import TrackedObject

ALIKE = 1.5  # largest ratio of two apparent heights of the same object


@dataclass(frozen=True)
class Apparent:
    """Angles in rad: azimuth (left positive), width and height. In the height, errors of the distance cancel out."""

    bearing_rad: float
    width_rad: float
    height_rad: float

    @classmethod
    def of(cls, each: TrackedObject, lamps: Tensor) -> Self:
        """The appearance of an object from the lamps' positions `[L, 3]` m."""
        x, y, _ = (each.T_world_object[:3, 3].double() - lamps.double().mean(0)).tolist()
        _, width, height = each.size_m
        distance_m = max(math.hypot(x, y), NEAREST_M)
        return cls(math.atan2(y, x), width / distance_m, height / distance_m)

    def same(self, other: "Apparent") -> bool:
        """Whether both are at the same place, within the larger width, and of about the same height."""
        off = abs(math.remainder(self.bearing_rad - other.bearing_rad, math.tau))
        low, high = sorted((self.height_rad, other.height_rad))
        return off < max(self.width_rad, other.width_rad) and high < ALIKE * low
