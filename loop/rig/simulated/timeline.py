"""What the lamp shows when. Times are those of `time.monotonic()`."""

import threading
import time
from collections import deque
from dataclasses import dataclass

from luxloop.loop.rig.wire.ddp import LightFrame

MOST_KEPT = 128  # frames of light, of which some are as large as a third of a megabyte
KEPT_S = 2.5  # longer than an exposure with its readout


@dataclass(frozen=True, eq=False)
class Segment:
    """Light from one time to another, None where the lamp is dark."""

    from_s: float
    to_s: float
    light: LightFrame | None


@dataclass(frozen=True)
class LampState:
    """light_sum: of the codes as shares. dark_since_s: None where it is lit."""

    lit: bool
    light_sum: float
    dark_since_s: float | None


@dataclass(eq=False)
class _Entry:
    from_s: float
    until_s: float
    light: LightFrame


class Timeline:
    """Light that inputs of any kind show. It goes out by itself when nothing has come for `timeout_s`."""

    def __init__(self, timeout_s: float, latency_s: float = 0.0) -> None:
        """latency_s: from `show` to the light."""
        self.timeout_s, self.latency_s = timeout_s, latency_s
        self.begun_s: float | None = None
        self._entries, self._changed = deque[_Entry](maxlen=MOST_KEPT), threading.Condition()
        self._dark_from_s: float | None = time.monotonic()

    def show(self, light: LightFrame) -> None:
        """Light from now on, and word that its sender is alive. What is shown already, by its time codes, stays."""
        with self._changed:
            from_s = time.monotonic() + self.latency_s
            last = self._entries[-1] if self._entries else None
            if last is not None and from_s <= last.until_s and light.timecodes == last.light.timecodes:
                last.until_s = from_s + self.timeout_s
                return
            dark_from_s = self._dark_at(from_s)
            self._dark_from_s = None if light.codes.any() else from_s if dark_from_s is None else dark_from_s
            if last is not None:
                last.until_s = min(last.until_s, from_s)
            self._entries.append(_Entry(from_s, from_s + self.timeout_s, light))
            while self._entries[0].until_s < from_s - KEPT_S:
                self._entries.popleft()
            self.begun_s = from_s if self.begun_s is None else self.begun_s
            self._changed.notify_all()

    def between(self, from_s: float, to_s: float) -> list[Segment]:
        """What is lit between two times, without a gap; the later one is not in the future."""
        with self._changed:
            found, at_s = list[Segment](), from_s
            for each in self._entries:
                start_s, end_s = max(each.from_s, from_s), min(each.until_s, to_s)
                if start_s < end_s:
                    if at_s < start_s:
                        found.append(Segment(at_s, start_s, None))
                    found.append(Segment(start_s, end_s, each.light))
                    at_s = end_s
            return [*found, Segment(at_s, to_s, None)] if at_s < to_s else found

    @property
    def heard_s(self) -> float | None:
        """When light came last, be it dark; None for never."""
        with self._changed:
            return self._entries[-1].until_s - self.timeout_s if self._entries else None

    def newer(self, than_s: float, timeout_s: float) -> float | None:
        """When the first light after a time begins, waiting for it; None where none comes."""

        def found() -> float | None:
            return next((each.from_s for each in self._entries if each.from_s > than_s), None)

        with self._changed:
            return self._changed.wait_for(found, timeout_s)

    def state(self) -> LampState:
        """The lamp's now."""
        with self._changed:
            now_s = time.monotonic()
            dark_from_s = self._dark_at(now_s)
            shown = next((each.light for each in reversed(self._entries) if each.from_s <= now_s < each.until_s), None)
        share = 0.0 if shown is None else float(shown.codes.sum(dtype=float)) / float(2 ** (8 * shown.codes.itemsize) - 1)
        return LampState(share > 0, share, dark_from_s if share == 0 else None)

    def _dark_at(self, at_s: float) -> float | None:
        """Since when it is dark at a time that is not before the newest light."""
        last = self._entries[-1] if self._entries else None
        if self._dark_from_s is None and last is not None and at_s > last.until_s:
            return last.until_s
        return self._dark_from_s
