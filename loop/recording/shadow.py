"""How the light that a run asks for differs from the light that its frames show, where a recording is played."""

from collections.abc import Sequence
from typing import Any

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.simulation.protocol import Showing

Lights = tuple[Utilisation, ...]


class ShadowTally:
    """Compares the lights of exposures with those that were shown in their place; `add` what was shown in a step."""

    def __init__(self) -> None:
        self._asked = dict[int, Lights]()
        self._shares = list[float]()

    def add(self, showings: Sequence[Showing]) -> None:
        """Take exposures, and the frames that have come."""
        for showing in showings:
            self._asked[showing.exposure.number] = showing.exposure.lights
            for frame in showing.after.frames:
                lights = self._asked.pop(frame.number, None)
                if lights is not None and frame.shown is not None:
                    self._shares.append(elsewhere(lights, frame.shown.lights))

    def summary(self) -> dict[str, Any]:
        """`exposures`: number compared. `differ`: number of those with other light. `elsewhere`: mean of `elsewhere` over all, None without
        any.
        """
        count = len(self._shares)
        return {
            "exposures": count,
            "differ": sum(share > 0 for share in self._shares),
            "elsewhere": sum(self._shares) / count if count else None,
        }


def elsewhere(asked: Lights, shown: Lights) -> float:
    """Sum over all pixels of the difference of utilisations, relative to the sum of both: 0 for the same light, 1 where none overlaps."""
    pairs = list(zip(asked, shown, strict=True))
    both = sum(float((a.u + b.u).sum()) for a, b in pairs)
    return sum(float((a.u - b.u).abs().sum()) for a, b in pairs) / both if both else 0.0
