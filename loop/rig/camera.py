"""The camera's thread: connects, reads pictures, and reconnects after a failure."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from luxloop.loop.rig.arrays import Data
from luxloop.loop.rig.matching import Regularity
from luxloop.world.errors import LuxloopError

KEY = "camera.kind"
KEPT = 8  # newest pictures in the queue; older ones are dropped
AGAIN_S = 0.5  # between two attempts to connect
STEP_S = 0.1  # longest wait of a read, so that the thread can end
PAUSE_S = 1e-3  # after a picture, for other threads: a read that never waits holds the interpreter's lock


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """A picture from a camera.

    arrived_s: arrival of the first byte, by `time.monotonic`. awaited: whether the reader waited for the picture; a picture from a buffer
    may be older than arrived_s says. data: encoded, or `[height, width]` or `[height, width, 3]` (blue, green, red) of 8 or 16 bits.
    late_s: lateness against the camera's rhythm in s, set by the camera's thread.
    """

    arrived_s: float
    awaited: bool
    data: Data
    late_s: float = 0.0


class CameraSource(Protocol):
    """A connection to a camera."""

    def read(self, timeout_s: float) -> CameraPicture | None:
        """The next picture, None if none arrives within timeout_s. Raises any exception if the connection is lost."""
        ...

    def close(self) -> None: ...


class Camera:
    """The newest pictures of a camera, read in a thread of its own."""

    def __init__(self, connect: Callable[[], CameraSource], timeout_s: float) -> None:
        """connect: opens a connection. timeout_s: time without a picture until the camera is reconnected."""
        self._connect, self._timeout_s = connect, timeout_s
        self._changed, self._pictures = threading.Condition(), deque[CameraPicture](maxlen=KEPT)
        self._open, self._source = True, cast(CameraSource | None, None)
        self._last_s, self._failure = -np.inf, ""
        self._misfit: tuple[float, str] | None = None  # time of the first picture that does not fit, and the reason
        self.count = self.dropped = self.connections = 0
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether pictures arrive and fit the scenario."""
        now_s, misfit = time.monotonic(), self._misfit
        return now_s - self._last_s <= self._timeout_s and (misfit is None or now_s - misfit[0] <= self._timeout_s)

    def note_misfit(self, misfit: str | None) -> None:
        """Note why the last picture does not fit the scenario, None if it does. Only fitting pictures keep the lamp lit."""
        self._misfit = None if misfit is None else (self._misfit[0] if self._misfit else time.monotonic(), misfit)

    @property
    def reason(self) -> str:
        """Reason why no fitting pictures arrive."""
        if self._misfit is not None and time.monotonic() - self._last_s <= self._timeout_s:
            return self._misfit[1]
        if self._source is not None or not self._failure:
            return f"camera: no picture for {self._timeout_s:g} s"
        return self._failure

    def next(self, until_s: float) -> CameraPicture | None:
        """The oldest picture in the queue, None if none arrives until until_s, by `time.monotonic`."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._pictures) or not self._open, max(until_s - time.monotonic(), 0))
            return self._pictures.popleft() if self._pictures else None

    def forget(self) -> int:
        """Drop all pictures in the queue; returns their number."""
        with self._changed:
            dropped = len(self._pictures)
            self._pictures.clear()
        return dropped

    def trigger(self) -> None:
        """Trigger a frame. Raises LuxloopError if a camera class of the user's own fails."""
        source = self._source
        if source is not None:
            cast(Any, source).trigger()

    def close(self) -> None:
        """End the thread; a thread that hangs in a driver is abandoned and ends with the program."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        self._thread.join(2)

    def _run(self) -> None:
        while self._open:
            try:
                self._source = self._connect()
                self.connections += 1
                try:
                    self._read(self._source)
                finally:
                    source, self._source = self._source, None
                    source.close()
            except Exception as error:  # drivers and streams raise anything; the watchdog darkens the lamp
                text = str(error) or type(error).__name__
                self._failure = text if isinstance(error, LuxloopError) else str(LuxloopError(f"camera: {text}"))
            until_s = time.monotonic() + AGAIN_S
            while self._open and time.monotonic() < until_s:
                time.sleep(0.02)

    def _read(self, source: CameraSource) -> None:
        heard_s, regularity = time.monotonic(), Regularity()
        while self._open:
            picture = check_picture(source.read(STEP_S))
            if picture is not None:
                heard_s = time.monotonic()
                self._last_s = max(self._last_s, picture.arrived_s)
                picture = replace(picture, late_s=regularity.late(picture.arrived_s))
                with self._changed:
                    self.dropped += len(self._pictures) == KEPT
                    self._pictures.append(picture)
                    self.count += 1
                    self._changed.notify_all()
                time.sleep(PAUSE_S)
            elif time.monotonic() - heard_s > self._timeout_s:
                raise LuxloopError(f"camera: no picture for {self._timeout_s:g} s")


def check_picture(picture: Any) -> CameraPicture | None:
    """The result of a camera's `read`, checked. Raises LuxloopError if it is neither None nor a valid CameraPicture."""
    if picture is None:
        return None
    if not isinstance(picture, CameraPicture):
        raise LuxloopError(f"{KEY}: read gives a {type(picture).__name__}; return a luxloop.CameraPicture, or None where none has come")
    if not isinstance(picture.arrived_s, int | float) or not -np.inf < picture.arrived_s <= time.monotonic() + 1e-3:
        raise LuxloopError(f"{KEY}: read gives the time {picture.arrived_s!r}; give time.monotonic() when the picture had come")
    data: Any = picture.data
    image = isinstance(data, np.ndarray) and data.dtype in (np.uint8, np.uint16) and data.size and data.ndim > 1
    if not isinstance(data, bytes) and not (image and data.shape[2:] in ((), (3,), (4,))):
        what = f"{data.dtype} {list(data.shape)}" if isinstance(data, np.ndarray) else type(data).__name__
        raise LuxloopError(f"{KEY}: read gives a picture of {what}; give uint8 or uint16 [height, width] or [height, width, 3], or bytes")
    return picture
