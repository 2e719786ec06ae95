"""How an object appears from the lamps: what tells whether it has come nearer, and whether a new one is one that is missed."""

import math
from dataclasses import dataclass
from typing import Self

from torch import Tensor

from controllers.obl.light import NEAREST_M
from controllers.situation import TrackedObject

ALIKE = 1.5  # factor up to which two heights may be those of the same object


@dataclass(frozen=True)
class Apparent:
    """Angles in rad: where it stands, to the left, and how wide and high it is; of its height errors of its distance cancel out."""

    bearing_rad: float
    width_rad: float
    height_rad: float

    @classmethod
    def of(cls, each: TrackedObject, lamps: Tensor) -> Self:
        """lamps: `[L, 3]` m."""
        x, y, _ = (each.T_world_object[:3, 3].double() - lamps.double().mean(0)).tolist()
        _, width, height = each.size_m
        distance_m = max(math.hypot(x, y), NEAREST_M)
        return cls(math.atan2(y, x), width / distance_m, height / distance_m)

    def same(self, other: "Apparent") -> bool:
        """Whether it is where the other is, by no more than the width of the larger, and about as high."""
        off = abs(math.remainder(self.bearing_rad - other.bearing_rad, math.tau))
        low, high = sorted((self.height_rad, other.height_rad))
        return off < max(self.width_rad, other.width_rad) and high < ALIKE * low
