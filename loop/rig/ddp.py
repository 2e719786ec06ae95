"""Light by DDP over UDP."""

import socket
from collections.abc import Sequence

import numpy as np

from luxloop.loop.rig.light import Shine, places
from luxloop.loop.rig.params import DdpLightParams
from luxloop.loop.rig.wire.addresses import REFUSED, reason_of
from luxloop.loop.rig.wire.ddp import Codes, WireCommand, codes_of, packets, send, sequence
from luxloop.world.errors import LuxloopError

FAREWELLS = 3  # times that darkness is sent, since a packet may be lost


class DdpLight:
    """A lamp on the network. The time code of an exposure is its number plus the number of times that the lamp was darkened before."""

    def __init__(self, params: DdpLightParams, grids: Sequence[tuple[int, int]]) -> None:
        """grids: rows and columns of the modules' pixels. Raises LuxloopError if the host has no address."""
        self._params = params
        self._order = [places(params.scan, *grid) for grid in grids]
        self._pixels = sum(map(len, self._order))
        try:
            found = socket.getaddrinfo(params.host, params.port, type=socket.SOCK_DGRAM)
            where = min(found, key=lambda each: each[0] != socket.AF_INET)  # lamps on a network have no IPv6 address as a rule
            self._socket = socket.socket(where[0], socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            self._socket.settimeout(1.0)
            self._socket.connect(where[4])
        except REFUSED as error:
            raise LuxloopError(
                f"light.host: {params.host} cannot be reached ({reason_of(error)}); check the name, and the network"
            ) from error
        self._number, self._timecode, self._darkened = -1, -1, 0
        self._sequence = sequence()
        self._frame: tuple[Codes, list[WireCommand] | None] | None = None

    @property
    def timecode(self) -> int:
        """Time code of the last frame, -1 before the first."""
        return self._timecode

    def show(self, shine: Shine) -> str | None:
        """Send a frame, new light `repeats` times. Returns the reason if it could not be sent, else None."""
        fresh = self._frame is None or shine.number != self._number
        if self._frame is None or fresh:
            self._number, self._timecode = shine.number, shine.number + self._darkened
            self._frame = self._codes(shine), self._commands(shine)
        return self._sent(*self._frame, self._params.repeats if fresh else 1)

    def dark(self) -> None:
        """Send a dark frame, several times."""
        self._darkened += 1
        self._timecode += 1
        self._frame = None
        dark = codes_of(np.zeros(self._pixels), self._params.bits)
        rest = [WireCommand()] * len(self._order) if self._params.commands else None
        self._sent(dark, rest, FAREWELLS)

    def close(self) -> None:
        self._socket.close()

    def _codes(self, shine: Shine) -> Codes:
        pictures = shine.pictures if self._params.commands else shine.dimmed
        ordered = [u.ravel()[order] for u, order in zip(pictures, self._order, strict=True)]
        return codes_of(np.concatenate(ordered), self._params.bits, self._params.gamma)

    def _commands(self, shine: Shine) -> list[WireCommand] | None:
        if not self._params.commands:
            return None
        given = [WireCommand(each.swivel_deg, each.level_deg, each.intensity) for each in shine.commands]
        return given or [WireCommand()] * len(self._order)

    def _sent(self, codes: Codes, commands: list[WireCommand] | None, times: int) -> str | None:
        where, reason = f"{self._params.host}:{self._params.port}", None
        for _ in range(times):
            try:
                send(self._socket, packets(codes, self._timecode if self._params.timecode else None, commands, self._sequence))
            except ConnectionRefusedError:  # word of an earlier packet
                reason = f"light: nobody listens at {where}"
            except OSError as error:  # a full buffer, say; the next time may go out
                reason = f"light: sending to {where} fails ({reason_of(error)})"
        return reason
