"""The lamp: timeline of its light, and its inputs, DDP packets or a loop's page."""

import json
import random
import socket
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import ClientConnection, connect

from luxloop.loop.rig.arrays import Grids, pixels_in
from luxloop.loop.rig.screen import DARK, HEAD, parse_message, split_picture
from luxloop.loop.rig.simulated.faults import LightInputParams
from luxloop.loop.rig.wire.ddp import LARGEST_PACKET, Assembler, LightFrame
from luxloop.loop.rig.wire.sockets import REFUSED, udp_listener

MOST_KEPT = 128  # frames of light, of which some are as large as a third of a megabyte
KEPT_S = 2.5  # history of light, longer than an exposure with its readout


@dataclass(eq=False)
class Segment:
    """Light from one time to another, None for dark."""

    from_s: float
    to_s: float
    light: LightFrame | None


class Timeline:
    """Timeline of light from an input. Light ends `timeout_s` after the last frame."""

    def __init__(self, timeout_s: float, latency_s: float = 0.0) -> None:
        """latency_s: delay from `show` to the light."""
        self.timeout_s, self.latency_s = timeout_s, latency_s
        self.begun_s: float | None = None
        self._entries, self._changed = deque[Segment](maxlen=MOST_KEPT), threading.Condition()
        self._dark_from_s: float | None = time.monotonic()

    def show(self, light: LightFrame) -> None:
        """Show light from now on, or extend the light of the same time codes, as a sign of life."""
        with self._changed:
            from_s = time.monotonic() + self.latency_s
            last = self._entries[-1] if self._entries else None
            if last is not None and last.light is not None and from_s <= last.to_s and light.timecodes == last.light.timecodes:
                last.to_s = from_s + self.timeout_s
                return
            dark_from_s = self._dark_at(from_s)
            self._dark_from_s = None if light.codes.any() else from_s if dark_from_s is None else dark_from_s
            if last is not None:
                last.to_s = min(last.to_s, from_s)
            self._entries.append(Segment(from_s, from_s + self.timeout_s, light))
            while self._entries[0].to_s < from_s - KEPT_S:
                self._entries.popleft()
            self.begun_s = from_s if self.begun_s is None else self.begun_s
            self._changed.notify_all()

    def between(self, from_s: float, to_s: float) -> list[Segment]:
        """Gapless segments between two times; the later one is not in the future."""
        with self._changed:
            found, at_s = list[Segment](), from_s
            for each in self._entries:
                start_s, end_s = max(each.from_s, from_s), min(each.to_s, to_s)
                if start_s < end_s:
                    if at_s < start_s:
                        found.append(Segment(at_s, start_s, None))
                    found.append(Segment(start_s, end_s, each.light))
                    at_s = end_s
            return [*found, Segment(at_s, to_s, None)] if at_s < to_s else found

    @property
    def heard_s(self) -> float | None:
        """Time of the last frame of light, dark ones included; None before the first."""
        with self._changed:
            return self._entries[-1].to_s - self.timeout_s if self._entries else None

    def newer(self, than_s: float, timeout_s: float) -> float | None:
        """Start of the first light after a time, None if none begins within the time-out."""

        def found() -> float | None:
            return next((each.from_s for each in self._entries if each.from_s > than_s), None)

        with self._changed:
            return self._changed.wait_for(found, timeout_s)

    def state(self) -> dict[str, Any]:
        """State of the lamp now. light_sum: sum of the codes as shares. dark_since_s: None while lit."""
        with self._changed:
            now_s = time.monotonic()
            dark_from_s = self._dark_at(now_s)
            shown = next((each.light for each in reversed(self._entries) if each.from_s <= now_s < each.to_s), None)
        share = 0.0 if shown is None else float(shown.codes.sum(dtype=float)) / float(2 ** (8 * shown.codes.itemsize) - 1)
        return {"lit": share > 0, "light_sum": share, "dark_since_s": dark_from_s if share == 0 else None}

    def _dark_at(self, at_s: float) -> float | None:
        """Start of the current darkness, at a time not before the newest light; None while lit."""
        last = self._entries[-1] if self._entries else None
        if self._dark_from_s is None and last is not None and at_s > last.to_s:
            return last.to_s
        return self._dark_from_s


BUFFER_BYTES = 2**22  # of the socket; systems may grant less
LOOK_S = 0.2  # interval of checks for the end


class DdpInput:
    """Input of DDP packets, in a thread; it shows each whole frame. where: its address, for messages."""

    def __init__(self, timeline: Timeline, pixels: int, params: LightInputParams, address: tuple[str, int], seed: int) -> None:
        """Listen; port 0 is a free port. Raises LuxloopError if the port is not available."""
        host, port = address
        self._timeline, self._params, self._random = timeline, params, random.Random(seed)
        self._socket = udp_listener(f"--light-port {port}", host, port)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._socket.settimeout(min(LOOK_S, params.timeout_ms / 1000))
        self.port: int = self._socket.getsockname()[1]
        self.where, self._assembler = f"udp://{host}:{self.port} (DDP)", Assembler(pixels, params.mixed)
        self._frames, self._open = 0, True
        self._thread = threading.Thread(target=self._receive, name="light", daemon=True)
        self._thread.start()

    def counts(self) -> dict[str, int]:
        """Number of frames shown, incomplete frames, and refused packets so far."""
        return {"frames": self._frames, "incomplete": self._assembler.incomplete, "refused": self._assembler.refused}

    def close(self) -> None:
        """Stop listening."""
        self._open = False
        self._thread.join()
        self._socket.close()

    def _receive(self) -> None:
        buffer = bytearray(LARGEST_PACKET + 1)  # one more, to detect longer packets
        view, loss, heard_s = memoryview(buffer), self._params.packet_loss, time.monotonic()
        while self._open:
            try:
                size = self._socket.recv_into(buffer)
            except TimeoutError:
                if time.monotonic() - heard_s >= self._params.timeout_ms / 1000:
                    self._assembler.forget()  # the next sender may start with any time code
                continue
            except OSError:
                continue  # an earlier sender has gone
            heard_s = time.monotonic()
            if loss and self._random.random() < loss:
                continue
            if (light := self._assembler.take(view[:size])) is not None:
                self._frames += 1
                self._timeline.show(light)


AGAIN_S = 0.2  # between two attempts to connect to a loop
PATIENCE_S = 2.0  # time-out of an attempt
LARGEST_TEXT = 1000  # bytes


class ScreenInput:
    """Input from a loop's light `screen`, in a thread; acts as a browser's page and reconnects by itself.

    It confirms each frame, and reports when it has darkened after the timeline's time-out without a sign of life.
    """

    def __init__(self, timeline: Timeline, grids: Grids, address: tuple[str, int]) -> None:
        """grids: rows and columns of each module. address: of the page."""
        self._timeline, self._grids, self._address = timeline, grids, address
        self.where = "http://{}:{}/ (the page of a loop's light `screen`)".format(*address)
        self._dark = LightFrame(np.zeros(pixels_in(grids), np.uint8), ())
        self._shown: LightFrame | None = None  # None while dark
        self._heard_s, self._counts, self._open = 0.0, {"frames": 0, "incomplete": 0, "refused": 0}, True
        self._thread = threading.Thread(target=self._run, name="light", daemon=True)
        self._thread.start()

    def counts(self) -> dict[str, int]:
        """Number of frames shown, incomplete frames, and refused packets so far."""
        return self._counts

    def close(self) -> None:
        """Close the page."""
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
            if message == DARK:
                self._darken()
            elif self._shown is not None:
                self._timeline.show(self._shown)  # sign of life
            return
        began_s = time.monotonic()
        try:
            number, picture = parse_message(message)
            codes = split_picture(picture, self._grids)
        except ValueError:
            self._counts["refused"] += 1
            return
        self._shown = LightFrame(codes, (number,))
        self._timeline.show(self._shown)
        self._counts["frames"] += 1
        drawn_ms, shown_ms = 1000 * began_s, 1000 * time.monotonic()
        page.send(json.dumps({"number": number, "drawn_ms": drawn_ms, "presented_ms": shown_ms, "now_ms": shown_ms}))

    def _darken(self) -> None:
        if self._shown is not None:
            self._shown = None
            self._timeline.show(self._dark)
