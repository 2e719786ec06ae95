"""Light as DDP, the Distributed Display Protocol: the pixels of a frame in UDP packets, and back.

A packet has a header of 10 bytes, big endian, 14 with a time code, and at most 1440 bytes of data:

| byte | value |
| --- | --- |
| 0 | 0x40: version 1; plus 0x10 with a time code, plus 0x01 in the last packet of a frame (push) |
| 1 | packet number, 1 to 15 cyclic, counted over frames |
| 2 | 0x23: grey, 8 bits; 0x24: grey, 16 bits, big endian |
| 3 | 1: pixels; 246: module commands as JSON, sent before the pixels |
| 4-7 | offset of the data in the frame in bytes, a multiple of 1440 |
| 8-9 | length of the data in bytes |
| 10-13 | time code of the frame, if flagged: here a number, not the NTP time of the specification |

One time code stands for one content, so a repeated frame repairs its lost packets. Without time codes, a packet whose offset is not larger
than the previous packet's begins a new frame.

Source: Distributed Display Protocol, 3waylabs.
"""

import itertools
import json
import socket
import struct
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import Commands, ModuleCommand

PORT = 4048
DATA_BYTES = 1440  # most data of a packet, which fits an Ethernet frame
LARGEST_PACKET = 14 + DATA_BYTES
VERSION, TIMECODE, PUSH = 0x40, 0x10, 0x01
VERSION_BITS = 0xC0
GREY8, GREY16 = 0x23, 0x24
PIXELS, COMMANDS = 1, 246
BURST = 64  # packets that any receiver's buffer holds
TIMECODES = 2**32

Codes = NDArray[np.uint8] | NDArray[np.uint16]
_HEADER, _TIMECODE = struct.Struct(">BBBBIH"), struct.Struct(">I")


@dataclass(frozen=True, eq=False)
class LightFrame:
    """A received frame of light.

    codes: `[n]` of all modules one after another. commands: one per module, None if none were sent. timecodes: of the frame, and in a mixed
    frame of the older frames that fill its gaps.
    """

    codes: Codes
    timecodes: tuple[int, ...]
    commands: Commands | None = None


def codes_of(u: NDArray[np.floating], bits: int, gamma: float = 1.0) -> Codes:
    """Codes `[n]` of utilisations `[n]` in 0..1: `round((2^bits - 1) u^(1/gamma))`. bits: 8 or 16."""
    shares = np.clip(u, 0, 1)
    most = 2**bits - 1
    codes = np.rint((shares if gamma == 1 else shares ** (1 / gamma)) * most)
    return codes.astype(np.uint8 if bits == 8 else np.uint16)


def utilisations_of(codes: Codes, gamma: float = 1.0) -> NDArray[np.float32]:
    """Utilisations `[n]` of codes `[n]`, the inverse of `codes_of`."""
    shares = codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
    return shares if gamma == 1 else shares ** np.float32(gamma)


def sequence() -> Iterator[int]:
    """Packet numbers of a sender."""
    return itertools.cycle(range(1, 16))


def packets(
    codes: Codes, timecode: int | None = None, commands: Sequence[object] | None = None, numbers: Iterator[int] | None = None
) -> Iterator[bytes]:
    """Packets of a frame in the order of sending. numbers: packet numbers from `sequence`; left out: from 1.

    Raises LuxloopError if the commands do not fit into one packet.
    """
    kind = GREY8 if codes.dtype == np.uint8 else GREY16
    numbers = sequence() if numbers is None else numbers
    flags, tail = (VERSION, b"") if timecode is None else (VERSION | TIMECODE, _TIMECODE.pack(timecode % TIMECODES))
    if commands is not None:
        text = json.dumps({"modules": [vars(each) for each in commands]}, separators=(",", ":")).encode()
        if len(text) > DATA_BYTES:
            raise LuxloopError(f"commands of {len(commands)} modules take {len(text)} bytes, more than the {DATA_BYTES} of a packet")
        yield _HEADER.pack(flags, next(numbers), kind, COMMANDS, 0, len(text)) + tail + text
    data = memoryview(codes.tobytes() if kind == GREY8 else codes.astype(">u2").tobytes())
    for offset in range(0, len(data), DATA_BYTES):
        part = data[offset : offset + DATA_BYTES]
        last = offset + DATA_BYTES >= len(data)
        yield _HEADER.pack(flags | PUSH * last, next(numbers), kind, PIXELS, offset, len(part)) + tail + part


def send(sock: socket.socket, frame: Iterable[bytes], pause_s: float = 0.0002) -> None:
    """Send the packets of a frame over a connected UDP socket, with a pause after each 64 in which the receiver empties its buffer.

    Raises OSError as sockets do, such as ConnectionRefusedError if nobody received an earlier packet.
    """
    for number, packet in enumerate(frame):
        if number and number % BURST == 0:
            time.sleep(pause_s)
        sock.send(packet)


class Assembler:
    """Assembles packets to frames of a given number of pixels, one frame at a time.

    A frame is complete with its last missing packet; from a sender of module commands a frame without commands is incomplete. incomplete:
    number of frames abandoned for a newer one. refused: number of invalid packets.
    """

    def __init__(self, pixels: int, mixed: bool = False) -> None:
        """mixed: whether an incomplete frame is returned at its push, its gaps filled with older light, as by simple lamps."""
        self.pixels, self.mixed = pixels, mixed
        self.incomplete = self.refused = 0
        self._given_out = False
        self._implied, self._place = 0, -2  # of packets without time code: frame number, last offset
        self.forget()

    def forget(self) -> None:
        """Reset: the next frame may have any time code."""
        self._timecode: int | None = None
        self._kind = 0
        self._buffer = bytearray()
        self._origins = dict[int, int]()  # time code of the data by its offset
        self._missing = 0
        self._commands: Commands | None = None
        self._commanding = self._given = False

    def take(self, packet: bytes | memoryview) -> LightFrame | None:
        """Take a received packet; returns the frame that it completes, or None."""
        if len(packet) < _HEADER.size:
            self.refused += 1
            return None
        flags, _, kind, id_, offset, length = _HEADER.unpack_from(packet)
        data = packet[_HEADER.size + (_TIMECODE.size if flags & TIMECODE else 0) :]
        if flags & VERSION_BITS != VERSION or kind not in (GREY8, GREY16) or length != len(data):
            self.refused += 1
            return None
        whole = self.pixels * (1 if kind == GREY8 else 2)
        commands = None
        if id_ == COMMANDS:
            commands = _commands(bytes(data))
        if commands is None and (id_ != PIXELS or offset % DATA_BYTES or offset >= whole or length != min(DATA_BYTES, whole - offset)):
            self.refused += 1
            return None
        timecode = self._timecode_of(packet, flags, -1 if id_ == COMMANDS else offset)
        if timecode != self._timecode or kind != self._kind:
            if self._timecode is not None and 0 < (self._timecode - timecode) % TIMECODES < TIMECODES // 2:
                return None  # late: a newer frame has begun
            self._begin(timecode, kind, whole)
        if commands is not None:
            self._commands, self._given, self._commanding = commands, True, True
        elif self._origins.get(offset) != timecode:
            self._buffer[offset : offset + length] = data
            self._origins[offset] = timecode
            self._missing -= 1
        elif self._given_out:
            return self._frame() if flags & PUSH else None  # a repeated whole frame is a sign of life
        if self._given_out:
            return None
        complete = not self._missing and (self._given or not self._commanding)
        if complete or (self.mixed and id_ == PIXELS and flags & PUSH):
            self._given_out = complete
            return self._frame()
        return None

    def _timecode_of(self, packet: bytes | memoryview, flags: int, place: int) -> int:
        """Time code of a packet's frame, or the frame's number if it has none."""
        if flags & TIMECODE:
            found: int = _TIMECODE.unpack_from(packet, _HEADER.size)[0]
            return found
        self._implied = (self._implied + (place <= self._place)) % TIMECODES
        self._place = place
        return self._implied

    def _begin(self, timecode: int, kind: int, whole: int) -> None:
        if self._timecode is not None and not self._given_out:
            self.incomplete += 1
        if kind != self._kind or len(self._buffer) != whole:
            self._buffer, self._origins = bytearray(whole), {}
        self._timecode, self._kind = timecode, kind
        self._missing = -(-whole // DATA_BYTES)
        self._given = self._given_out = False

    def _frame(self) -> LightFrame:
        data = bytes(self._buffer)
        codes: Codes = np.frombuffer(data, np.uint8) if self._kind == GREY8 else np.frombuffer(data, ">u2").astype(np.uint16)
        assert self._timecode is not None
        older = set(self._origins.values()) - {self._timecode}
        return LightFrame(codes, (self._timecode, *sorted(older)), self._commands)


def _commands(text: bytes) -> Commands | None:
    """Module commands of a JSON text, None if it is invalid."""
    try:
        modules = json.loads(text)["modules"]
        commands = tuple(ModuleCommand(**{key: float(value) for key, value in each.items()}) for each in modules)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    fine = all(abs(each.swivel_deg) <= 180 and abs(each.level_deg) <= 180 and 0 <= each.intensity <= 1 for each in commands)
    return commands if fine else None
