"""Figures: bodies whose shape changes with the way that they have come, as legs do."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

import torch
from torch import Tensor

from luxloop.world.scene.body import Body, PoseTrack

SHAPES: Final = 32  # of a cycle; a walker has one for every 5 cm


@dataclass(frozen=True, eq=False)
class Figure:
    """A body with a cycle of shapes.

    shape: makes the body of a share 0..1 of the cycle; its track is not used. cycle_m: way of a cycle. start: share at the way's start.
    """

    name: str
    shape: Callable[[float], Body]
    cycle_m: float
    track: PoseTrack
    start: float = 0.0

    def phase_at(self, t_s: float) -> float:
        """Share of the cycle at a time, in steps of one shape."""
        return round((self.start + self.track.travelled_m(t_s) / self.cycle_m) * SHAPES) % SHAPES / SHAPES

    def at(self, t_s: float) -> Body:
        """The shape at a time."""
        return self.made(self.phase_at(t_s))

    @cached_property
    def bounds(self) -> Tensor:
        """Lowest and highest coordinates of all shapes in the body frame, `[2, 3]` float64 m."""
        low, high = torch.stack([self.made(k / SHAPES).bounds for k in range(SHAPES)], 1)
        return torch.stack([low.amin(0), high.amax(0)])

    @cached_property
    def made(self) -> Callable[[float], Body]:
        """`shape`, memoised, so that what is derived from a body is used again."""
        return cache(self.shape)
