"""A client of the studio for tests: what docs/programs.md says, without luxloop's own code."""

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import ClientConnection, connect

Arrays = dict[str, np.ndarray]


def message(arrays: Arrays | None = None, coding: str = "deflate", **head: Any) -> bytes:
    """A message of a client."""
    body, listed = b"", {}
    for name, array in (arrays or {}).items():
        raw = array.tobytes()
        data = {"raw": raw, "deflate": zlib.compress(raw)}.get(coding) or cv2.imencode(".png", array)[1].tobytes()
        dtype = array.dtype.str[1:]
        listed[name] = {"dtype": dtype, "shape": array.shape, "start": len(body), "bytes": len(data), "coding": coding}
        body += data
    text = json.dumps(head | ({"arrays": listed} if listed else {})).encode()
    return struct.pack("<I", len(text)) + text + body


def unpacked(data: bytes) -> tuple[dict[str, Any], Arrays]:
    """Head and arrays of a message of the server."""
    (length,) = struct.unpack_from("<I", data)
    head, body = json.loads(data[4 : 4 + length]), data[4 + length :]
    arrays = {}
    for name, each in head.get("arrays", {}).items():
        part = body[each["start"] : each["start"] + each["bytes"]]
        if each["coding"] == "png":
            arrays[name] = cv2.imdecode(np.frombuffer(part, np.uint8), cv2.IMREAD_UNCHANGED)
            continue
        raw = zlib.decompress(part) if each["coding"] == "deflate" else part
        arrays[name] = np.frombuffer(raw, f"<{each['dtype']}").reshape(each["shape"])
    return head, arrays


class Watcher:
    """A connection, and all that came by it."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket, self.got = socket, list[tuple[dict[str, Any], Arrays]]()

    def say(self, type: str, arrays: Arrays | None = None, **head: Any) -> None:
        """Send a message."""
        self.socket.send(message(arrays, type=type, **head))

    def set(self, *overrides: str) -> dict[str, Any]:
        """Set keys, and wait for the edit."""
        self.say("set", overrides=overrides)
        return self.of("edit")[0]

    def step(self, *steps: int) -> None:
        """Do steps of these numbers one after the other."""
        for step in steps:
            self.say("step")
            self.of("step", step=step)

    def reset(self) -> None:
        """Begin anew."""
        self.say("reset")
        self.of("scenario")

    def until(self, fits: Callable[[dict[str, Any]], bool], timeout_s: float = 120.0) -> tuple[dict[str, Any], Arrays]:
        """Wait for a message that fits; the time is what a busy machine takes to prepare a scenario."""
        while True:
            data = self.socket.recv(timeout_s)
            assert isinstance(data, bytes)
            self.got.append(unpacked(data))
            if self.got[-1][0]["type"] == "step":
                self.say("shown", id=self.got[-1][0]["id"])
            if fits(self.got[-1][0]):
                return self.got[-1]

    def of(self, kind: str, **values: Any) -> tuple[dict[str, Any], Arrays]:
        """Wait for a message of a type with these values."""
        return self.until(lambda head: head["type"] == kind and all(head.get(key) == value for key, value in values.items()))


@contextmanager
def watching(port: int, token: str) -> Iterator[Watcher]:
    """A client that has said hello."""
    with connect(f"ws://127.0.0.1:{port}/socket", max_size=None, compression=None) as socket:
        watcher = Watcher(socket)
        watcher.say("hello", token=token)
        yield watcher
