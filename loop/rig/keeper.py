"""Keeps the lamp alive while the loop and the camera are, and darkens it otherwise."""

import threading
import time
from collections.abc import Callable
from typing import Final

from loop.rig.light import Light, Shine, checked_reason
from loop.rig.params import LightParams

STILL: Final = 0.8  # of the lamp's own time-out, within which light that was sent surely stands


class Keeper:
    """Owns a light. Its thread sends the light that stands again, as long as the loop has a beat and `fault` names none.

    reason: why the light that stands may not shine. darkened: how often the watchdog has darkened the lamp. interruptions: how often light
    that stood came into doubt.
    """

    def __init__(self, light: Light, params: LightParams, loop_s: float, fault: Callable[[], str | None]) -> None:
        """loop_s: without a beat after which the loop counts as dead. fault: why the lamp must be dark, None where it need not."""
        self._light, self._params, self._loop_s, self._fault = light, params, loop_s, fault
        self._lock, self._wake, self._open = threading.RLock(), threading.Event(), True
        self._standing: Shine | None = None
        self._beat_s = self._sent_s = time.monotonic()
        self._since_s: float | None = None
        self.darkened, self.reason, self.interruptions = 0, "light: is dark", 0
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    @property
    def since_s(self) -> float | None:
        """Time by which all of the light that stands had left here, without a gap since; None where it may not shine, for `reason`."""
        with self._lock:
            return None if self._standing is None else self._since_s

    def beat(self) -> None:
        """The loop lives."""
        self._beat_s = time.monotonic()

    def show(self, shine: Shine) -> str | None:
        """Send new light. Returns why it cannot be known to shine, None where it was sent."""
        with self._lock:
            self.beat()
            reason = checked_reason(self._light.show(shine))
            self._standing, self._sent_s = shine, time.monotonic()
            self._since_s, self.reason = (self._sent_s, "") if reason is None else (None, reason)
            return reason

    def dark(self, reason: str) -> None:
        """Darken, until light is shown again. reason: in words."""
        with self._lock:
            self.reason = reason
            if self._standing is not None:
                self._standing = None
                self._light.dark()

    def close(self) -> None:
        """Dark for good."""
        self._open = False
        self._wake.set()
        with self._lock:
            self._standing = None
            self._light.dark()
            self._light.close()
        self._thread.join(2)

    def _run(self) -> None:
        while not self._wake.wait(self._params.keep_alive_s):
            with self._lock:
                if self._standing is None or not self._open:
                    continue
                now_s = time.monotonic()
                dead = f"the loop has said nothing for {self._loop_s:g} s" if now_s - self._beat_s > self._loop_s else self._fault()
                if dead is not None:
                    self.darkened += 1
                    self.dark(dead)
                    continue
                if now_s - self._sent_s < self._params.keep_alive_s / 2:
                    continue
                gap_s = now_s - self._sent_s
                reason = self._light.show(self._standing)
                self._sent_s = time.monotonic()
                if gap_s > STILL * self._params.dark_after_s:
                    reason = f"the lamp may have been dark: nothing was sent to it for more than {STILL * self._params.dark_after_s:.2g} s"
                if reason is not None:
                    self.interruptions, self.reason, self._since_s = self.interruptions + 1, reason, None
