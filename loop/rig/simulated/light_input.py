"""Light that comes over the network. Other inputs show `LightFrame`s on the same timeline."""

import random
import socket
import threading
import time
from typing import Final, NamedTuple

from luxloop.loop.rig.simulated.faults import LightInputParams
from luxloop.loop.rig.simulated.timeline import Timeline
from luxloop.loop.rig.wire.addresses import REFUSED, reason_of
from luxloop.loop.rig.wire.ddp import LARGEST_PACKET, Assembler
from luxloop.world.errors import LuxloopError

BUFFER_BYTES: Final = 2**22  # of the socket; systems may give less
LOOK_S: Final = 0.2  # between two looks at whether the end has come


class Counts(NamedTuple):
    """Frames of light that were shown, that lacked packets, and what was refused."""

    frames: int = 0
    incomplete: int = 0
    refused: int = 0


class DdpInput:
    """Takes DDP packets in a thread of its own and shows each whole frame."""

    def __init__(self, timeline: Timeline, pixels: int, params: LightInputParams, address: tuple[str, int], seed: int) -> None:
        """Listen; a port of 0 takes a free one. Raises LuxloopError where it cannot be had."""
        host, port = address
        self._timeline, self._params, self._random = timeline, params, random.Random(seed)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(address)
        except REFUSED as error:
            self._socket.close()
            raise LuxloopError(
                f"--light-port {port}: cannot listen on {host}:{port} ({reason_of(error)}); give another, 0 for a free one"
            ) from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._socket.settimeout(min(LOOK_S, params.timeout_ms / 1000))
        self.port: int = self._socket.getsockname()[1]
        self._where, self._assembler = f"udp://{host}:{self.port} (DDP)", Assembler(pixels, params.mixed)
        self._frames, self._open = 0, True
        self._thread = threading.Thread(target=self._receive, name="light", daemon=True)
        self._thread.start()

    @property
    def where(self) -> str:
        """From where the light comes, in words."""
        return self._where

    def counts(self) -> Counts:
        """What has come so far."""
        return Counts(self._frames, self._assembler.incomplete, self._assembler.refused)

    def close(self) -> None:
        """Stop to listen."""
        self._open = False
        self._thread.join()
        self._socket.close()

    def _receive(self) -> None:
        buffer = bytearray(LARGEST_PACKET + 1)  # a longer packet is seen to be too long
        view, loss, heard_s = memoryview(buffer), self._params.packet_loss, time.monotonic()
        while self._open:
            try:
                size = self._socket.recv_into(buffer)
            except TimeoutError:
                if time.monotonic() - heard_s >= self._params.timeout_ms / 1000:
                    self._assembler.forget()  # the next sender may begin with any time code
                continue
            except OSError:
                continue  # the system tells of a sender that has gone
            heard_s = time.monotonic()
            if loss and self._random.random() < loss:
                continue
            if (light := self._assembler.take(view[:size])) is not None:
                self._frames += 1
                self._timeline.show(light)
