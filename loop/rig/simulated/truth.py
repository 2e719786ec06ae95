"""What was true, for tests: frames with the light in them, and the lamp's state, as JSON over HTTP."""

import json
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from luxloop.loop.rig.simulated.camera import Exposed
from luxloop.loop.rig.wire.mjpeg import server_of

MOST_FRAMES: Final = 4096


class TruthServer:
    """`GET /truth` gives frames in the order of sending and what `state` tells, `?since=INDEX` only frames from that index on; `GET
    /truth/rig` gives what `rig` tells.
    """

    def __init__(self, host: str, port: int, state: Callable[[], dict[str, Any]], rig: dict[str, Any]) -> None:
        """Listen. Raises LuxloopError where the port cannot be had."""
        self._frames, self._lock, self._state = deque[Exposed](maxlen=MOST_FRAMES), threading.Lock(), state
        self._rig = json.dumps(rig).encode()
        ours = self

        class Handler(BaseHTTPRequestHandler):
            timeout = 5.0

            def do_GET(self) -> None:
                ours._answer(self)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self._server = server_of(Handler, host, port, "--truth-port")
        self.port: int = self._server.server_address[1]

    def add(self, frame: Exposed) -> None:
        """A frame that is being sent."""
        with self._lock:
            self._frames.append(frame)

    def close(self) -> None:
        """Stop to listen."""
        self._server.shutdown()
        self._server.server_close()

    def _answer(self, handler: BaseHTTPRequestHandler) -> None:
        asked = urlsplit(handler.path)
        if asked.path == "/truth/rig":
            body = self._rig
        elif asked.path == "/truth":
            given = parse_qs(asked.query).get("since", ["0"])[0]
            since = int(given) if given.isdecimal() and len(given) < 16 else 0
            with self._lock:
                frames = [asdict(each) for each in self._frames if each.index >= since]
            body = json.dumps({"frames": frames, **self._state()}).encode()
        else:
            handler.send_error(404)
            return
        try:
            handler.send_response(200)
            handler.send_header("Content-Type", "application/json")
            handler.send_header("Content-Length", str(len(body)))
            handler.end_headers()
            handler.wfile.write(body)
        except OSError:
            pass  # the client has gone
