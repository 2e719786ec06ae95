"""The file of a scenario that somebody may edit while it runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from luxloop.loop.scenario.model import Scenario


@dataclass
class WatchedFile:
    """path: None of what comes from no file. scenario: that was read from it last."""

    path: Path | None = None
    scenario: "Scenario | None" = None

    def __post_init__(self) -> None:
        self._stamp = self._now()

    def changed(self) -> bool:
        """Whether it is another file than when this was asked last."""
        before, self._stamp = self._stamp, self._now()
        return self._stamp is not None and self._stamp != before

    def _now(self) -> tuple[int, int] | None:
        try:
            stat = None if self.path is None else self.path.stat()
        except OSError:  # while an editor replaces it
            return None
        return stat and (stat.st_mtime_ns, stat.st_size)
