"""What edits can be taken back."""

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Literal

from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.scenario.model import Scenario

    Scenarios = tuple[Scenario, ...]  # of all runs

TOGETHER_S: Final = 1.0  # edits of the same keys that follow each other as fast, as of a drag, are one
MOST: Final = 200


class History:
    """Scenarios before each edit, and after those that were taken back."""

    def __init__(self) -> None:
        self._kept: dict[Literal["undo", "redo"], list[Scenarios]] = {"undo": [], "redo": []}
        self._last: tuple[frozenset[str], float] = frozenset(), 0.0

    def add(self, before: "Scenarios", overrides: Sequence[str], stroke: int = 0) -> None:
        """An edit was made. before: the scenarios before it. stroke: number, above 0, of what it is part of, however long that takes."""
        keys = frozenset({f"stroke {stroke}"} if stroke else (each.partition("=")[0].strip() for each in overrides))
        now_s, together_s = time.monotonic(), math.inf if stroke else TOGETHER_S
        (same, then_s), self._last = self._last, (keys, now_s)
        if keys != same or now_s - then_s > together_s:
            self._kept["undo"] = [*self._kept["undo"], before][-MOST:]
        self._kept["redo"] = []

    def newest(self, way: Literal["undo", "redo"]) -> "Scenarios":
        """Where a way leads. Raises LuxloopError where it leads nowhere."""
        if not self._kept[way]:
            raise LuxloopError(f"{way}: there is nothing to {way}")
        return self._kept[way][-1]

    def go(self, way: Literal["undo", "redo"], before: "Scenarios") -> None:
        """A way was gone. before: the scenarios before that."""
        self._kept[way].pop()
        self._kept["redo" if way == "undo" else "undo"].append(before)
        self._last = frozenset(), 0.0
