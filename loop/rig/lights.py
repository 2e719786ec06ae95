"""Light devices of a rig file: a lamp with DDP over UDP, files for a user's own player, a web page, or a user's own class."""

import json
import os
from contextlib import suppress
from typing import cast

import cv2
import numpy as np

from luxloop.loop.rig.arrays import Grids
from luxloop.loop.rig.light import KEY, LightDevice, Shine, places
from luxloop.loop.rig.params import DdpLightParams, FilesLightParams, Lights, ScreenLightParams
from luxloop.loop.rig.screen import ScreenLight, stack_pictures
from luxloop.loop.rig.wire.ddp import Codes, codes_of, packets, send, sequence
from luxloop.loop.rig.wire.sockets import udp_sender
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write
from luxloop.world.headlight.lamp import REST, Commands

METHODS = ("show", "dark", "close")
FAREWELLS = 3  # dark frames at the end, since a packet may be lost


class DdpLight(LightDevice):
    """A lamp on the network.

    The time code of an exposure is its number plus the number of times that the lamp was darkened before.
    """

    def __init__(self, params: DdpLightParams, grids: Grids) -> None:
        """grids: rows and columns of the modules' pixels. Raises LuxloopError if the host has no address."""
        self._params = params
        self._order = [places(params.scan, *grid) for grid in grids]
        self._socket = udp_sender("light.host", params.host, params.port)
        self._number, self._timecode, self._darkened = -1, -1, 0
        self._sequence = sequence()
        self._rest = (REST,) * len(grids) if params.commands else None
        self._frame: tuple[Codes, Commands | None] | None = None

    @property
    def timecode(self) -> int:
        """Time code of the last frame, -1 before the first."""
        return self._timecode

    def show(self, shine: Shine) -> str | None:
        """Send a frame, new light `repeats` times. Returns None, or the reason why it could not be sent."""
        fresh = self._frame is None or shine.number != self._number
        if self._frame is None or fresh:
            self._number, self._timecode = shine.number, shine.number + self._darkened
            pictures = shine.net_pictures if self._rest is None else shine.pictures
            ordered = [u.ravel()[order] for u, order in zip(pictures, self._order, strict=True)]
            codes = codes_of(np.concatenate(ordered), self._params.bits, self._params.gamma)
            self._frame = codes, self._rest and (shine.commands or self._rest)
        return self._send(*self._frame, self._params.repeats if fresh else 1)

    def dark(self) -> None:
        """Send a dark frame, several times."""
        self._darkened += 1
        self._timecode += 1
        self._frame = None
        self._send(codes_of(np.zeros(sum(map(len, self._order))), self._params.bits), self._rest, FAREWELLS)

    def close(self) -> None:
        self._socket.close()

    def _send(self, codes: Codes, commands: Commands | None, times: int) -> str | None:
        where, reason = f"{self._params.host}:{self._params.port}", None
        for _ in range(times):
            try:
                send(self._socket, packets(codes, self._timecode if self._params.timecode else None, commands, self._sequence))
            except ConnectionRefusedError:  # reported by an earlier packet
                reason = f"light: nobody listens at {where}"
            except OSError as error:  # such as a full buffer; the next packet may go out
                reason = f"light: sending to {where} fails ({error.strerror or error})"
        return reason


PICTURE, ABOUT = "light.png", "light.json"


class FilesLight(LightDevice):
    """Each light atomically replaces `light.png`, then `light.json` with number and commands."""

    def __init__(self, params: FilesLightParams) -> None:
        """Raises LuxloopError if the folder does not exist or cannot be written."""
        self._params, self._number, self._shape = params, -1, (1, 1)
        if not params.folder.is_dir() or not os.access(params.folder, os.W_OK):
            raise LuxloopError(f"light.folder: {params.folder} is no folder that can be written; make it")

    def show(self, shine: Shine) -> str | None:
        """Write new light; for current light touch `light.json`, as a sign of life. Returns None, or the reason of a failure."""
        try:
            if shine.number == self._number:
                os.utime(self._params.folder / ABOUT)
            else:
                codes = stack_pictures([codes_of(u, self._params.bits, self._params.gamma) for u in shine.pictures])
                self._write(codes, {"number": shine.number, "modules": [vars(each) for each in shine.commands]})
                self._number, self._shape = shine.number, codes.shape
        except (LuxloopError, OSError) as error:
            return f"light: {error}"
        return None

    def dark(self) -> None:
        """Write a black picture."""
        self._number = -1
        with suppress(LuxloopError):
            self._write(codes_of(np.zeros(self._shape), self._params.bits), {"number": None, "modules": []})

    def _write(self, codes: Codes, about: dict[str, object]) -> None:
        picture = cv2.imencode(".png", codes, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        for name, content in ((PICTURE, picture), (ABOUT, json.dumps(about))):
            atomic_write(self._params.folder / name, content)


def open_light(params: Lights, grids: Grids) -> LightDevice:
    """Light device of a rig file. grids: rows and columns of the modules' pixels. Raises LuxloopError if it cannot be opened."""

    match params:
        case DdpLightParams():
            return DdpLight(params, grids)
        case ScreenLightParams():
            return ScreenLight(params, grids)
        case FilesLightParams():
            return FilesLight(params)
    return cast(LightDevice, plugin.make(params.kind, KEY, {"grids": tuple(grids)}, params.options, METHODS))
