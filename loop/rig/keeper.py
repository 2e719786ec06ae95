"""The watchdog: a thread that keeps the light on while loop and camera are alive, and darkens the lamp otherwise.

If the whole process is killed, the lamp's own time-out (`light.dark_after_s`) darkens it.
"""

import math
import threading
import time
from collections.abc import Callable

from luxloop.loop.rig.light import LightDevice, Shine, check_reason
from luxloop.loop.rig.params import LightParams

STILL = 0.8  # share of the lamp's own time-out within which its light is certain
CLOSE_S = 2.0  # wait at the end for a device or thread that hangs


class Keeper:
    """The watchdog of a light. Its thread repeats the current light while the loop calls `beat` and `fault` returns None.

    reason: why the current light may not be shown. darkened: number of times the watchdog has darkened the lamp. interruptions: number of
    times the current light may have been interrupted.
    """

    def __init__(self, light: LightDevice, params: LightParams, loop_s: float, fault: Callable[[], str | None]) -> None:
        """loop_s: time without a beat after which the loop counts as dead. fault: returns the reason for which the lamp must be dark, or
        None.
        """
        self._light, self._params, self._loop_s, self._fault = light, params, loop_s, fault
        self._lock, self._wake, self._open = threading.RLock(), threading.Event(), True
        self._standing: Shine | None = None
        self._beat_s = self._sent_s = time.monotonic()
        self._since_s: float | None = None
        self._dark_s: float | None = -math.inf
        self._broken: str | None = None  # exception of the light device since the last new light
        self.darkened, self.reason, self.interruptions = 0, "light: is dark", 0
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    @property
    def since_s(self) -> float | None:
        """Time at which the current light was sent, if it has shone without a gap since; None otherwise, for `reason`."""
        with self._lock:
            self._notice_gap()
            return None if self._standing is None else self._since_s

    @property
    def dark_since_s(self) -> float | None:
        """Time at which the lamp was darkened, minus infinity before the first light; None while it is lit."""
        return self._dark_s

    def beat(self) -> None:
        """Signal that the loop is alive."""
        self._beat_s = time.monotonic()

    def show(self, shine: Shine) -> str | None:
        """Send new light. Returns None, or the reason why it may not be shown."""
        with self._lock:
            self.beat()
            reason = check_reason(self._light.show(shine))
            self._standing, self._sent_s, self._broken, self._dark_s = shine, time.monotonic(), None, None
            self._since_s, self.reason = (self._sent_s, "") if reason is None else (None, reason)
            return reason

    def dark(self, reason: str) -> None:
        """Darken the lamp until the next `show`. reason: for messages."""
        with self._lock:
            self.reason, self._since_s = reason, None
            if self._standing is not None:
                self._light.dark()
                self._standing, self._dark_s = None, time.monotonic()

    def close(self) -> None:
        """Darken the lamp and end, even if a device hangs in `show`."""
        self._open = False
        self._wake.set()
        held = self._lock.acquire(timeout=CLOSE_S)
        try:
            self._standing = None
            self._light.dark()
        finally:
            self._light.close()
            if held:
                self._lock.release()
        self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while not self._wake.wait(self._params.keep_alive_s):
            with self._lock:
                try:
                    self._watch()
                except Exception as error:  # of a device; the lamp is darkened, again and again if that fails
                    self._broken, self._since_s = str(error) or type(error).__name__, None

    def _watch(self) -> None:
        """Repeat the current light, or darken the lamp."""
        if self._standing is None or not self._open:
            return
        silent = time.monotonic() - self._beat_s > self._loop_s
        dead = self._broken or (f"the loop has said nothing for {self._loop_s:g} s" if silent else self._fault())
        if dead is not None:
            self.dark(dead)
            self.darkened += 1
            return
        if time.monotonic() - self._sent_s < self._params.keep_alive_s / 2:
            return
        reason = check_reason(self._light.show(self._standing))
        self._notice_gap()
        self._sent_s = time.monotonic()
        if reason is not None:
            self._doubt(reason)

    def _notice_gap(self) -> None:
        """Note a gap since the last sending, since a frame may be taken before the thread notices it."""
        longest_s = STILL * self._params.dark_after_s
        if self._standing is not None and self._since_s is not None and time.monotonic() - self._sent_s > longest_s:
            self._doubt(f"the lamp may have been dark: nothing was sent to it for more than {longest_s:.2g} s")

    def _doubt(self, reason: str) -> None:
        self.interruptions, self.reason, self._since_s = self.interruptions + 1, reason, None
