"""Pictures of a network camera: parts of one endless HTTP answer (`multipart/x-mixed-replace`), and back.

Each part is a JPEG or PNG with `Content-Type` and `Content-Length`, without number or time. A slow client misses pictures.
"""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler
from typing import Any

from luxloop.loop.rig.wire.sockets import serve_http
from luxloop.world.errors import LuxloopError

BOUNDARY = b"--frame"
JPEG, PNG = "image/jpeg", "image/png"
MOST_CLIENTS = 8
LONGEST_LINE = 1024  # bytes of a part's header line
MOST_LINES = 32


@dataclass(frozen=True, eq=False)
class Part:
    """An encoded picture. kind: its media type."""

    body: bytes
    kind: str


class PictureServer:
    """Server that sends each picture to the clients that are ready. clients: number of clients."""

    def __init__(self, host: str, port: int, path: str = "/camera") -> None:
        """Listen. Raises LuxloopError if the port cannot be opened."""
        self.path = path
        self._changed, self._part, self._number, self._open, self.clients = threading.Condition(), Part(b"", JPEG), 0, True, 0
        self._server = serve_http(f"--camera-port {port}", host, port, self._answer)
        self.port = self._server.server_address[1]

    def publish(self, part: Part) -> None:
        """Send a picture to all clients without waiting for them."""
        with self._changed:
            self._part, self._number = part, self._number + 1
            self._changed.notify_all()

    def close(self) -> None:
        """End all answers and stop listening."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()

    def _answer(self, handler: BaseHTTPRequestHandler) -> None:
        if handler.path.partition("?")[0] != self.path:
            handler.send_error(404)
            return
        with self._changed:
            full = self.clients >= MOST_CLIENTS
            self.clients += not full
            last = self._number
        if full:
            handler.send_error(503)
            return
        try:
            handler.send_response(200)
            handler.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY[2:].decode()}")
            handler.send_header("Cache-Control", "no-store")
            handler.end_headers()
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._number != last or not self._open)  # noqa: B023
                    if not self._open:
                        return
                    part, last = self._part, self._number
                head = b"%s\r\nContent-Type: %s\r\nContent-Length: %d\r\n\r\n" % (BOUNDARY, part.kind.encode(), len(part.body))
                handler.wfile.write(head + part.body + b"\r\n")
        except OSError:
            pass  # the client has gone, or does not read
        finally:
            with self._changed:
                self.clients -= 1


def parts(stream: Any, largest: int) -> Iterator[Part]:
    """Parts of an answer's body as they arrive, until its end.

    stream: with `read` and `readline`. largest: largest picture in bytes. Raises LuxloopError for other answers, and OSError as streams do.
    """
    while (size_and_kind := _head(stream)) is not None:
        size, kind = size_and_kind
        if size > largest:
            raise LuxloopError(f"camera: a picture of {size} bytes, where {largest} are expected at most; check the camera's address")
        body = stream.read(size)
        if len(body) < size:
            return
        yield Part(body, kind)


def _head(stream: Any) -> tuple[int, str] | None:
    """Size in bytes and media type of the next part, None at the end."""
    size, kind, begun = None, JPEG, False
    for _ in range(MOST_LINES):
        line = stream.readline(LONGEST_LINE)
        text = line.strip()
        if not line or text == BOUNDARY + b"--":
            return None
        if not text and begun:
            if size is None:
                break
            return size, kind
        begun = begun or bool(text)  # with the boundary, or without it if the reader has dropped it
        name, _, value = text.partition(b":")
        if name.lower() == b"content-length" and value.strip().isdigit() and len(value.strip()) < 12:
            size = int(value)
        elif name.lower() == b"content-type":
            kind = value.strip().decode("latin-1").lower()
    raise LuxloopError('camera: its answer has no parts with Content-Length; give the address of an MJPEG stream, or kind = "stream"')
