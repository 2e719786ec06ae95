"""Digitised light textures with their delay in the simulated world, and statistics of their latency."""

from collections import deque
from typing import Any

from torch import Tensor

from luxloop.loop.rig.statistics import Lateness


class Beam:
    """Light textures of exposures, in order. newest: the last digitised texture of a lit lamp, with its utilisation `[n_p]`."""

    def __init__(self, late: int, dark: Tensor) -> None:
        """late: delay of the light in the simulated world, in exposures. dark: the texture before the first one."""
        self._under_way = deque[Tensor | None]([dark] * late, maxlen=late + 1)
        self._digitising, self._whole, self._saturated = Lateness(), Lateness(), 0.0
        self.newest: tuple[Tensor, Tensor] | None = None

    def take(self, texture: Tensor | None) -> Tensor | None:
        """Add the texture of an exposure, None if its frame is lost; returns the one that shines now, None if it is lost."""
        self._under_way.append(texture)
        return self._under_way[0]

    def note(self, digitising_s: float, since_light_s: float, saturated: float) -> None:
        """Record an exposure. digitising_s: frame to texture. since_light_s: sent light to texture. saturated: share of pixels."""
        self._digitising.add(digitising_s)
        self._whole.add(since_light_s)
        self._saturated = max(self._saturated, saturated)

    def summary(self) -> dict[str, Any]:
        """The statistics as plain data."""
        return {
            "light_to_texture_ms": self._whole.in_ms,
            "frame_to_texture_ms": self._digitising.in_ms,
            "saturated": round(self._saturated, 6),
        }
