"""What came of a lamp's light: the textures that are under way to the simulated world, and how long they took."""

from collections import deque
from typing import Any

from torch import Tensor

from loop.rig.statistics import Lateness


class Beam:
    """Light textures of exposures, in their order. newest: of the last light that was digitised, with its utilisation `[n_p]`."""

    def __init__(self, late: int, dark: Tensor) -> None:
        """late: exposures by which the light is late in the simulated world. dark: the texture before any."""
        self._under_way = deque[Tensor | None]([dark] * late, maxlen=late + 1)
        self._digitising, self._whole, self._saturated = Lateness(), Lateness(), 0.0
        self.newest: tuple[Tensor, Tensor] | None = None

    def take(self, texture: Tensor | None) -> Tensor | None:
        """Take the texture of an exposure, None where its frame is lost; the one that shines now."""
        self._under_way.append(texture)
        return self._under_way[0]

    def note(self, digitising_s: float, since_light_s: float, saturated: float) -> None:
        """digitising_s: from frame to texture. since_light_s: from light that was sent to there. saturated: share of camera pixels."""
        self._digitising.add(digitising_s)
        self._whole.add(since_light_s)
        self._saturated = max(self._saturated, saturated)

    def summary(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "light_to_texture_ms": self._whole.in_ms,
            "frame_to_texture_ms": self._digitising.in_ms,
            "saturated": round(self._saturated, 6),
        }
