"""Pictures of a network camera: an endless HTTP response with one JPEG or PNG per part. Sizes and times are bounded."""

import base64
import select
import socket
import time
from typing import Final
from urllib.parse import unquote, urlsplit

from loop.rig.camera import CameraPicture
from loop.rig.params import HttpCameraParams
from loop.wire.addresses import REFUSED, reason_of
from loop.wire.mjpeg import LONGEST_LINE, parts
from world.errors import LuxloopError

MOST_HEAD: Final = 16_384  # bytes of the answer's head
CHUNK: Final = 65_536
EXAMPLE: Final = "write it as http://192.168.1.21:8080/camera"
SLOW_S: Final = 2.0  # without a byte within a picture or a head


class HttpCamera:
    """One connection."""

    def __init__(self, params: HttpCameraParams) -> None:
        """Raises LuxloopError if the address is invalid, or the server does not send pictures."""
        self._url = params.url
        try:
            url = urlsplit(params.url)
            host, port = url.hostname, url.port or 80
        except ValueError as error:
            raise LuxloopError(
                f"camera.url: {params.url} is no address; {EXAMPLE}, and #, / and @ in a login as %23, %2F and %40"
            ) from error
        if not host:
            raise LuxloopError(f"camera.url: {params.url} names no host; {EXAMPLE}")
        try:
            self._socket = socket.create_connection((host, port), SLOW_S)
        except REFUSED as error:
            raise LuxloopError(f"camera.url: {params.url} cannot be reached ({reason_of(error)}); check it, and the network") from error
        self._stream = _Stream(self._socket)
        try:
            self._ask(host, url.path or "/", url.query, (url.username, url.password))
        except BaseException:
            self._socket.close()
            raise
        self._parts = parts(self._stream, params.largest_bytes)

    def read(self, timeout_s: float) -> CameraPicture | None:
        """The next picture, None if none has arrived within timeout_s. Raises OSError if a picture stops in between, LuxloopError if the
        response ends or is invalid.
        """
        if not self._stream.await_part(timeout_s):
            return None
        arrived_s, awaited = self._stream.arrived_s, self._stream.awaited
        part = next(self._parts, None)
        if part is None:
            raise LuxloopError("camera: has ended the stream")
        return CameraPicture(arrived_s, awaited, part.body)

    def close(self) -> None:
        self._socket.close()

    def _ask(self, host: str, path: str, query: str, user: tuple[str | None, str | None]) -> None:
        lines = [f"GET {path}{f'?{query}' if query else ''} HTTP/1.0", f"Host: {host}", "Accept: multipart/x-mixed-replace, image/*"]
        if user[0] is not None:
            login = f"{unquote(user[0])}:{unquote(user[1] or '')}".encode()
            lines.append(f"Authorization: Basic {base64.b64encode(login).decode()}")
        self._socket.sendall("\r\n".join([*lines, "", ""]).encode())
        status = self._stream.readline(MOST_HEAD).split(None, 2)
        if len(status) < 2 or status[1] != b"200":
            told = status[1].decode("latin-1") if len(status) > 1 else "no HTTP"
            raise LuxloopError(f"camera.url: {self._url} answers with {told}, not with pictures; check the path, and the login")
        left, kind = MOST_HEAD, b""
        while (line := self._stream.readline(left)).strip():
            left -= len(line)
            if left <= 0:
                raise LuxloopError("camera: the head of its answer does not end; check the address")
            name, _, value = line.partition(b":")
            kind = value.strip().lower() if name.lower() == b"content-type" else kind
            if name.lower() == b"transfer-encoding" and b"chunked" in value.lower():
                raise LuxloopError(f'camera.url: {self._url} answers in chunks, which kind = "http" cannot read; give kind = "stream"')
        if not kind.startswith(b"multipart/"):
            said = kind.decode("latin-1") or "no type"
            raise LuxloopError(f"camera.url: {self._url} answers with {said}, not with multipart pictures; give the MJPEG stream's path")


class _Stream:
    """A socket's bytes, with the time at which a part began to come. What is buffered is bounded by what is asked for."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket, self._buffer = sock, bytearray()
        self.arrived_s, self.awaited = 0.0, False

    def await_part(self, timeout_s: float) -> bool:
        """Wait for the first byte of the next part; whether it has come."""
        self._strip()
        self.awaited = False
        until_s = time.monotonic() + timeout_s
        while not self._buffer:
            if not self._ready(0):
                self.awaited = True
                if not self._ready(max(until_s - time.monotonic(), 0)):
                    return False
            self.arrived_s = time.monotonic()
            self._fill()
            self._strip()
        if not self.awaited:
            self.arrived_s = time.monotonic()
        return True

    def readline(self, limit: int) -> bytes:
        while (end := self._buffer.find(b"\n", 0, limit)) < 0 and len(self._buffer) < limit:
            self._fill()
        return self._taken(limit if end < 0 else end + 1)

    def read(self, size: int) -> bytes:
        while len(self._buffer) < size:
            self._fill()
        return self._taken(size)

    def _strip(self) -> None:
        """The end of the line that follows a picture belongs to it, and so does the boundary, which many cameras send at once."""
        while size := 1 if self._buffer[:1] in (b"\r", b"\n") else self._boundary():
            del self._buffer[:size]

    def _boundary(self) -> int:
        """Bytes of the boundary that comes next, 0 where none does, or the last one, or a part of one."""
        size = self._buffer.find(b"\n", 0, LONGEST_LINE) + 1
        line = self._buffer[:size].rstrip()
        return size if line.startswith(b"--") and not line.endswith(b"--") else 0

    def _ready(self, timeout_s: float) -> bool:
        return bool(select.select([self._socket], [], [], timeout_s)[0])

    def _fill(self) -> None:
        came = self._socket.recv(CHUNK)
        if not came:
            raise LuxloopError("camera: has closed the connection")
        self._buffer += came

    def _taken(self, size: int) -> bytes:
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken
