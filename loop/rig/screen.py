"""Light on a second display or a projector: a page that draws the pixels one to one and confirms each frame."""

import asyncio
import json
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from luxloop.loop.rig.arrays import Grids, Image
from luxloop.loop.rig.light import LightDevice, Shine, places
from luxloop.loop.rig.params import ScreenLightParams
from luxloop.loop.rig.wire.ddp import codes_of
from luxloop.loop.rig.wire.sockets import is_own_host, listening
from luxloop.world.errors import LuxloopError

DARK = '{"dark": true}'  # to the page
HEAD = struct.Struct(">IHH")  # of a message: number of the light, width and height of its picture


def stack_pictures(pictures: Sequence[Image]) -> Image:
    """Pictures of all modules one below the other, left-aligned, black beside: `[sum of rows, most columns]`."""
    width = max(each.shape[1] for each in pictures)
    return np.concatenate([np.pad(each, ((0, 0), (0, width - each.shape[1]))) for each in pictures])


def split_picture(picture: Image, grids: Grids) -> Image:
    """Pixels `[n]` of all modules one after another, row by row, from a picture of `stack_pictures`. grids: rows and columns of each
    module. Raises ValueError if the picture has another size.
    """
    rows, columns = np.transpose(grids)
    if picture.shape != (rows.sum(), columns.max()):
        raise ValueError("the picture has another size")
    parts = np.split(picture, np.cumsum(rows)[:-1])
    return np.concatenate([part[:, :n].ravel() for part, n in zip(parts, columns, strict=True)])


def message_of(number: int, codes: Image) -> bytes:
    """Message of a picture `[height, width]`: `HEAD`, big endian, and a byte per pixel, row by row from the top."""
    return HEAD.pack(number % 2**32, codes.shape[1], codes.shape[0]) + codes.tobytes()


def parse_message(message: bytes) -> tuple[int, Image]:
    """Number and picture `[height, width]` of a message. Raises ValueError for other bytes."""
    if len(message) < HEAD.size:
        raise ValueError(f"a message of {len(message)} bytes has no head")
    number, width, height = HEAD.unpack_from(message)
    return number, np.frombuffer(message, np.uint8, offset=HEAD.size).reshape(height, width)


PAGE = Path(__file__).parent / "page" / "screen.html"
LARGEST_ANSWER = 1000  # bytes
CONFIRMED_S = 0.5  # time-out of a page's confirmation


class ScreenLight(LightDevice):
    """Server of the page. The latest page to connect shows the light; a frame counts as shown once this page has confirmed it.

    answer: confirmation of the newest frame: its number, and drawn_ms, presented_ms and now_ms by the page's clock.
    """

    def __init__(self, params: ScreenLightParams, grids: Grids) -> None:
        """Listen in a thread. grids: rows and columns of the modules' pixels. Raises LuxloopError if the port cannot be opened."""
        self._params = params
        self._order = [places(params.scan.model_copy(update={"columns_first": False}), *grid) for grid in grids]
        self._changed = threading.Condition()
        self._page: ServerConnection | None = None
        self._shown_on: ServerConnection | None = None  # None after the page has darkened by itself
        self._number, self.answer = -1, dict[str, Any]()
        self._failed: LuxloopError | None = None
        self.port = 0
        self._ready, self._loop = threading.Event(), asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="screen", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._failed is not None:
            raise self._failed

    @property
    def has_page(self) -> bool:
        """Whether a page is connected."""
        return self._page is not None

    def await_page(self, ask: Callable[[str], None], seconds: float = 600.0) -> None:
        """Wait until a page is connected. ask: called with the address to open. Raises LuxloopError if none connects in time."""
        if not self.has_page:
            ask(f"http://{self._params.host}:{self.port}/")
        with self._changed:
            if not self._changed.wait_for(lambda: self._page is not None, seconds):
                raise LuxloopError("light: no page has connected; open the address that was printed on the projector")

    def show(self, shine: Shine) -> str | None:
        """Send new light and wait until the page has shown it; for current light only send a sign of life."""
        page = self._page
        if page is None:
            return f"light: no page shows it; open http://{self._params.host}:{self.port}/ on the projector"
        if shine.number == self._number:
            self._send(page, '{"alive": true}')
            return (
                None if self._shown_on is page else self._undone("light: the page darkened by itself, or another one has taken its place")
            )
        picture = stack_pictures([u.ravel()[order].reshape(u.shape) for u, order in zip(shine.net_pictures, self._order, strict=True)])
        codes = codes_of(picture, 8, self._params.gamma)
        self._number, self._shown_on = shine.number, page
        self._send(page, message_of(shine.number, codes.astype(np.uint8)))
        with self._changed:
            done = self._changed.wait_for(lambda: self.answer.get("number") == shine.number % 2**32 or self._page is not page, CONFIRMED_S)
        if self._page is not page:
            return self._undone("light: the page was closed")
        return None if done else self._undone("light: the page has not shown it in time")

    def _undone(self, reason: str) -> str:
        """Have the next light sent whole; returns the reason."""
        self._number = -1
        return reason

    def dark(self) -> None:
        self._number = -1
        if self._page is not None:
            self._send(self._page, DARK)

    def close(self) -> None:
        """Close the connection, which darkens the page, and stop listening."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(2)

    def _send(self, page: ServerConnection, data: bytes | str) -> None:
        async def send() -> None:
            with suppress(ConnectionClosed):
                await page.send(data)

        with suppress(RuntimeError, TimeoutError):  # the event loop has ended, or the page does not read
            asyncio.run_coroutine_threadsafe(send(), self._loop).result(CONFIRMED_S)

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._ready.set()
            self._loop.close()

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        host, port = self._params.host, self._params.port
        try:
            with listening("light.port", host, port, "give another port, 0 for a free one"):
                server = await serve(
                    self._client, host, port, process_request=self._file, max_size=LARGEST_ANSWER, compression=None, ping_timeout=5
                )
        except LuxloopError as error:
            self._failed = error
            return
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        await self._stop.wait()
        server.close()
        await server.wait_closed()

    def _file(self, connection: ServerConnection, request: Request) -> Response | None:
        host, origin = request.headers.get("Host", "").lower(), request.headers.get("Origin")
        path = request.path.partition("?")[0]
        if path == "/light" and is_own_host(host) and (origin is None or origin.lower() == f"http://{host}"):
            return None
        if path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "There is no such file.\n")
        response = connection.respond(HTTPStatus.OK, PAGE.read_text("utf-8"))
        del response.headers["Content-Type"]
        response.headers.update({"Content-Type": "text/html; charset=utf-8", "Cache-Control": "no-store"})
        return response

    async def _client(self, page: ServerConnection) -> None:
        with self._changed:
            before, self._page = self._page, page
            self._changed.notify_all()
        if before is not None:
            await before.close()
        try:
            await page.send(json.dumps({"dark_after_ms": 1000 * self._params.dark_after_s}))
            async for text in page:
                self._take(page, text)
        except ConnectionClosed:
            pass
        finally:
            with self._changed:
                self._page = None if self._page is page else self._page
                self._changed.notify_all()

    def _take(self, page: ServerConnection, text: str | bytes) -> None:
        try:
            answer = json.loads(text)
        except (ValueError, RecursionError):
            return
        if not isinstance(answer, dict) or page is not self._page:
            return
        if answer.get("darkened"):
            self._shown_on = None
        if isinstance(answer.get("number"), int):
            with self._changed:
                self.answer = {**answer, "arrived_s": time.monotonic()}
                self._changed.notify_all()
