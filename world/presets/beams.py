"""Beams of a preset, fitted to its pixels when they are first asked for."""

from collections.abc import Iterator, Mapping
from typing import Literal

from torch import Tensor

from world.lamp import Lamp

Traffic = Literal["right", "left"]


class FittedBeams(Mapping[str, tuple[Tensor, ...]]):
    """The default beams of a lamp by name: fitting takes seconds, so a lamp that only draws symbols must not pay for it."""

    def __init__(self, lamp: Lamp, traffic: Traffic = "right") -> None:
        self._lamp, self._traffic = lamp, traffic
        self._beams: dict[str, tuple[Tensor, ...]] | None = None

    def for_traffic(self, traffic: Traffic) -> "FittedBeams":
        """The same lamp's default beams where traffic drives on this side."""
        return self if traffic == self._traffic else FittedBeams(self._lamp, traffic)

    @property
    def _fitted(self) -> dict[str, tuple[Tensor, ...]]:
        if self._beams is None:
            from world.beams import default_beams

            self._beams = default_beams(self._lamp, self._traffic)
        return self._beams

    def __getitem__(self, name: str) -> tuple[Tensor, ...]:
        return self._fitted[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._fitted)

    def __len__(self) -> int:
        return len(self._fitted)
