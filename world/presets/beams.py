"""Beams of a preset, each fitted to its pixels when it is first asked for."""

from collections.abc import Iterator, Mapping

from torch import Tensor

from luxloop.world.beams import PATTERNS, fit
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.regulation.results import Traffic


class FittedBeams(Mapping[str, tuple[Tensor, ...]]):
    """The default beams of a lamp by name: fitting takes seconds, so nobody must pay for a beam that is not shown."""

    def __init__(self, lamp: Lamp, traffic: Traffic = "right") -> None:
        self._lamp, self._traffic = lamp, traffic
        self._fitted: dict[str, tuple[Tensor, ...]] = {}

    def for_traffic(self, traffic: Traffic) -> "FittedBeams":
        """The same lamp's default beams where traffic drives on this side."""
        return self if traffic == self._traffic else FittedBeams(self._lamp, traffic)

    def __getitem__(self, name: str) -> tuple[Tensor, ...]:
        if name not in self._fitted:
            self._fitted[name] = fit(self._lamp, PATTERNS[name], self._traffic)
        return self._fitted[name]

    def __contains__(self, name: object) -> bool:
        return name in PATTERNS

    def __iter__(self) -> Iterator[str]:
        return iter(PATTERNS)

    def __len__(self) -> int:
        return len(PATTERNS)
