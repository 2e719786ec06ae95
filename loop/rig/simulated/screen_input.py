"""Light that a loop draws on its page for a projector: the rig is that projector."""

import json
import threading
import time
from contextlib import suppress
from typing import Any, Final

import numpy as np
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import ClientConnection, connect

from luxloop.loop.rig.simulated.light_input import LOOK_S, Counts
from luxloop.loop.rig.simulated.timeline import Timeline
from luxloop.loop.rig.wire.addresses import REFUSED
from luxloop.loop.rig.wire.ddp import LightFrame
from luxloop.loop.rig.wire.screen import HEAD, understood, unstacked

AGAIN_S: Final = 0.2  # between two tries to reach a loop
PATIENCE_S: Final = 2.0  # in which a loop answers a try
LARGEST_TEXT: Final = 1000  # bytes


class ScreenInput:
    """Shows the page of a loop's light `screen` as a browser does, in a thread of its own; without a loop it tries again.

    It says when it shows a frame, and that it has darkened where no word of the loop has come for the timeline's time-out.
    """

    def __init__(self, timeline: Timeline, grids: list[tuple[int, int]], address: tuple[str, int]) -> None:
        """grids: rows and columns of each module. address: of the page."""
        self._timeline, self._grids, self._address = timeline, grids, address
        self._dark = LightFrame(np.zeros(sum(rows * columns for rows, columns in grids), np.uint8), ())
        self._shown: LightFrame | None = None  # None while it is dark by itself or as it was asked
        self._heard_s, self._counts, self._open = 0.0, Counts(), True
        self._thread = threading.Thread(target=self._run, name="light", daemon=True)
        self._thread.start()

    @property
    def where(self) -> str:
        """From where the light comes, in words."""
        return "http://{}:{}/ (the page of a loop's light `screen`)".format(*self._address)

    def counts(self) -> Counts:
        """What has come so far."""
        return self._counts

    def close(self) -> None:
        """Leave the page."""
        self._open = False
        self._thread.join()

    def _run(self) -> None:
        host, port = self._address
        largest = HEAD.size + sum(rows for rows, _ in self._grids) * max(columns for _, columns in self._grids)
        while self._open:
            with suppress(*REFUSED, WebSocketException):
                url, most = f"ws://{host}:{port}/light", max(largest, LARGEST_TEXT)
                with connect(url, proxy=None, compression=None, max_size=most, open_timeout=PATIENCE_S, close_timeout=PATIENCE_S) as page:
                    self._follow(page)
            self._darken()
            time.sleep(AGAIN_S)

    def _follow(self, page: ClientConnection) -> None:
        while self._open:
            try:
                message = page.recv(timeout=min(LOOK_S, self._timeline.timeout_s))
            except TimeoutError:
                message = None
            except ConnectionClosed:
                return
            if self._shown is not None and time.monotonic() - self._heard_s > self._timeline.timeout_s:
                self._darken()
                page.send(json.dumps({"darkened": True}))
            if message is not None:
                self._heard_s = time.monotonic()
                self._take(page, message)

    def _take(self, page: ClientConnection, message: str | bytes) -> None:
        if isinstance(message, str):
            if _told(message).get("dark"):
                self._darken()
            elif self._shown is not None:
                self._timeline.show(self._shown)  # word that the loop is alive
            return
        began_s = time.monotonic()
        try:
            number, picture = understood(message)
            codes = unstacked(picture, self._grids)
        except ValueError:
            self._counts = self._counts._replace(refused=self._counts.refused + 1)
            return
        self._shown = LightFrame(codes, (number,))
        self._timeline.show(self._shown)
        self._counts = self._counts._replace(frames=self._counts.frames + 1)
        drawn_ms, shown_ms = 1000 * began_s, 1000 * time.monotonic()
        page.send(json.dumps({"number": number, "drawn_ms": drawn_ms, "presented_ms": shown_ms, "now_ms": shown_ms}))

    def _darken(self) -> None:
        if self._shown is not None:
            self._shown = None
            self._timeline.show(self._dark)


def _told(text: str) -> dict[str, Any]:
    """What a text says; nothing where it is no JSON object."""
    try:
        told = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}
