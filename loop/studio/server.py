"""The studio's server: the page, and a socket for the clients of one session."""

import asyncio
import json
import math
import secrets
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response

from luxloop.loop.rig.wire.sockets import is_own_host, refusing
from luxloop.loop.studio.messages import (
    LARGEST,
    PROTOCOL,
    Acknowledge,
    AskBeam,
    AskMeter,
    AskSummary,
    Button,
    Drive,
    Hello,
    Message,
    Request,
    Scrub,
    Want,
    ask_of,
    read,
)
from luxloop.loop.studio.session import Session
from luxloop.loop.studio.sources import Source
from luxloop.world.errors import LuxloopError
from luxloop.world.files import installed_version
from luxloop.world.messages import pack

if TYPE_CHECKING:
    from luxloop.loop.studio.stream import Stream

HELLO_S = 10.0  # time-out of a client's token
UNKNOWN = 4401  # close code for a wrong token
DEAF_S = 20.0  # time-out of sending a message
ASLEEP_S = 0.5  # a client that has not shown a message for so long, as a hidden page, gets no new pictures until it has
STATUS_S = 0.1  # interval of messages on the session's state
READ_ONLY = ("hello", "want", "scrub", "shown", "summary", "beam", "meter", "schema")  # message types open to watchers
MOST_ANSWERS = 100  # unread by a client
MOST_ASKED = 50  # waiting messages of all clients, some megabytes each
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".txt": "text/plain; charset=utf-8"}


@dataclass(frozen=True)
class Tokens:
    """Tokens of clients that edit, or only watch."""

    edit: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    watch: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    def role(self, token: str) -> str | None:
        """Role of a token: `edit`, `watch`, or None for another one."""
        return next((role for role in ("edit", "watch") if secrets.compare_digest(token.encode(), getattr(self, role).encode())), None)


Ask = tuple[str, int]  # type of a request, and its run
Answer = tuple[dict[str, Any], Ask | None]


class Client:
    """A client's connection. number: unique. is_here: whether it comes from this machine. busy_s: by `time.monotonic`, since when it has
    messages of a run that it has not shown.
    """

    def __init__(self, connection: ServerConnection, number: int, role: str) -> None:
        self.connection, self.number, self.role = connection, number, role
        self.stream: Stream | None = None  # made where PyTorch is imported
        self.request = Request()
        self.is_here = ip_address(connection.remote_address[0]).is_loopback
        self.busy_s = math.inf
        self.changed, self.answers, self.asks = asyncio.Event(), list[Answer](), set[Ask]()

    def reply(self, head: dict[str, Any], ask: Ask | None = None) -> None:
        """Queue an answer. ask: the request that it answers, of which the client may send the next one once the answer is sent."""
        self.answers.append((head, ask))
        self.changed.set()

    @property
    def looks(self) -> bool:
        """Whether the client shows what it is sent."""
        return time.monotonic() < self.busy_s + ASLEEP_S

    def has_shown(self) -> None:
        """Note whether the client has shown all steps that it was sent."""
        if self.stream is not None and self.request.shown >= self.stream.id:
            self.busy_s = math.inf

    async def send(self, data: bytes) -> None:
        """Send a message. Raises TimeoutError if the client does not read."""
        async with asyncio.timeout(DEAF_S):
            await self.connection.send(data)


class Studio:
    """A session and its clients. Make it in a running event loop."""

    def __init__(self, sources: tuple[Source, ...], page: Path, tokens: Tokens, *, allow_code: bool = False, device: str = "auto") -> None:
        """page: folder of the page's files."""
        self.page, self.tokens = page, tokens
        self._loop = asyncio.get_running_loop()
        self._clients, self._number = list[Client](), 0
        self._pen: int | None = None
        self._threads = ThreadPoolExecutor(2, "messages")
        self.session = Session(sources, partial(self._later, self._tell), allow_code=allow_code, device=device)
        self._names = frozenset[str]()

    async def serve(self, host: str, port: int) -> Server:
        """Listen; port 0 is a free port. Raises LuxloopError if the port is not available."""
        remedy = "give an address of this machine and another --port, 0 for a free one"
        with refusing(f"--host {host} --port {port}: cannot listen there", remedy):
            server = await serve(
                self._client, host, port, process_request=self._answer, max_size=LARGEST, compression=None, ping_timeout=60
            )
        self._names |= {host.lower()}
        self.session.start()
        return server

    def stop(self) -> bool:
        """End the session after the current step. Returns whether it has ended."""
        self._threads.shutdown(cancel_futures=True)
        return self.session.stop()

    def _answer(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        host, origin = request.headers.get("Host", "").lower(), request.headers.get("Origin")
        if not is_own_host(host, self._names) or (origin is not None and origin.lower() not in (f"http://{host}", f"https://{host}")):
            return _response(HTTPStatus.FORBIDDEN, "text/plain", b"This address is not that of the studio.\n")
        path = request.path.partition("?")[0]
        if path == "/socket":
            return None
        name = "index.html" if path == "/" else path.removeprefix("/")
        known = {each.name: each for each in self.page.iterdir()} if self.page.is_dir() else {}
        if name not in known or known[name].suffix not in KINDS:
            return _response(HTTPStatus.NOT_FOUND, "text/plain", b"There is no such file.\n")
        return _response(HTTPStatus.OK, KINDS[known[name].suffix], known[name].read_bytes())

    async def _client(self, connection: ServerConnection) -> None:
        try:
            async with asyncio.timeout(HELLO_S):
                hello, _ = read(await connection.recv())
            role = self.tokens.role(hello.token) if isinstance(hello, Hello) else None
        except (TimeoutError, ConnectionClosed):  # a page on a busy machine reconnects
            await connection.close()
            return
        except LuxloopError:
            role = None
        if role is None:
            await connection.close(UNKNOWN, "this token is not of this studio; open the address that luxloop studio prints")
            return
        self._number += 1
        client = Client(connection, self._number, role)
        self._clients.append(client)
        if role == "edit" and self._pen is None:
            self._pen = client.number
        client.reply({"type": "welcome", "protocol": PROTOCOL, "version": installed_version(), "role": role, "id": client.number})
        sender = asyncio.create_task(self._keep_sending(client))
        self._tell()
        try:
            async for data in connection:
                self._receive(client, data)
                while len(client.answers) > MOST_ANSWERS or self.session.waiting > MOST_ASKED:  # a client that does not read is not served
                    await asyncio.sleep(STATUS_S)
        except ConnectionClosed:
            pass
        finally:
            sender.cancel()
            if client.stream is not None:
                client.stream.close()
            self._clients.remove(client)
            if self._pen == client.number:
                self._let_go()
                self._pen = next((each.number for each in self._clients if each.role == "edit"), None)
            self._tell()

    def _receive(self, client: Client, data: bytes | str) -> None:
        reply = client.reply
        message: Message | None = None
        try:
            message, arrays = read(data)
            self._refuse(client, message)
        except LuxloopError as error:
            reply({"type": "error", "text": str(error), "about": message and message.type, "ask": ask_of(data)})
            return
        match message:
            case Want(shared=True) if not client.is_here:
                text = "want: memory is shared with programs on the same machine alone; connect to 127.0.0.1 there, or ask without shared"
                reply({"type": "error", "text": text, "about": "want", "ask": message.ask})
            case Want(views=views, shared=shared):
                client.request = replace(client.request, wanted=frozenset(views), shared=shared)
                self._look()
                if message.ask is not None:  # `done` follows the view
                    self._inquire(client, message)
            case Scrub(step=step):
                client.request = replace(client.request, at=None if step is None else (message.run, step))
            case Acknowledge(id=id_):
                client.request = replace(client.request, shown=max(client.request.shown, id_))
                client.has_shown()
                self._look()
            case AskSummary() | AskBeam() | AskMeter() | Button(type="schema"):
                self._inquire(client, message)
            case Button(type="pen"):
                self._let_go()
                self._pen = client.number
                self._tell()
                self.session.ask(message, partial(self._later, reply))
            case Hello():
                pass
            case _:
                self.session.ask(message, partial(self._later, reply), arrays)
        client.changed.set()

    def _refuse(self, client: Client, message: Message) -> None:
        if message.type in READ_ONLY:
            return
        if client.role != "edit":
            raise LuxloopError(f"{message.type}: this address lets you watch; open the one that luxloop studio prints for editing")
        if message.type != "pen" and self._pen != client.number:
            raise LuxloopError(f"{message.type}: another page holds the pen; take it first")

    def _inquire(self, client: Client, message: Message) -> None:
        """Pass a watcher's request to the session, one of a type at a time."""
        ask = message.type, getattr(message, "run", 0)
        if ask in client.asks:
            text = f"{message.type}: the last one is not answered yet"
            client.reply({"type": "error", "text": text, "about": message.type, "ask": message.ask})
        else:
            client.asks.add(ask)
            self.session.ask(message, partial(self._later, partial(client.reply, ask=ask)))

    def _later(self, what: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the event loop, from another thread."""
        with suppress(RuntimeError):  # the event loop is closed
            self._loop.call_soon_threadsafe(what, *arguments)

    def _let_go(self) -> None:
        """End a drive."""
        self.session.ask(Drive(type="drive", throttle=None, steering=None), lambda head: None)

    def _look(self) -> None:
        self.session.look(frozenset(view for client in self._clients if client.looks for view in client.request.wanted))

    def _tell(self) -> None:
        self._look()
        for client in self._clients:
            client.changed.set()

    async def _keep_sending(self, client: Client) -> None:
        try:
            await self._send(client)
        except ConnectionClosed:
            pass
        except TimeoutError:  # a close message would not be read either
            client.connection.transport.abort()
        except Exception:
            traceback.print_exc()
            await client.connection.close(1011, "the server failed to send; the terminal of luxloop studio shows why")

    async def _send(self, client: Client) -> None:
        """Send what a client lacks after each change; while the client reads slowly, changes gather, and only the newest is sent."""
        last, said_s, preparing, chosen, soon, rests_s = "", 0.0, None, None, False, 0.0
        while True:
            await client.changed.wait()
            client.changed.clear()
            state = self.session.state
            answers, client.answers = client.answers, []
            for head, ask in answers:
                if ask is not None:
                    client.asks.discard(ask)
                await client.send(pack(head))
            if state.progress != preparing:
                preparing = state.progress
                await client.send(pack({"type": "progress", "text": preparing}))
            if state.choices is not chosen:
                chosen = state.choices
                await client.send(pack({"type": "choices", **(chosen or {})}))
            keys = ("playing", "speed", "step_ms", "real_time", "failed", "recording", "steps")
            status = {"type": "status", **{key: getattr(state, key) for key in keys}, "pen": self._pen, "clients": len(self._clients)}
            text, waits_s = json.dumps(status), said_s + STATUS_S - time.monotonic()
            if text == last:
                soon = False
            elif waits_s <= 0 or not state.playing:
                last, said_s, soon = text, time.monotonic(), False
                await client.send(pack(status))
            elif not soon:
                soon = True
                self._loop.call_later(waits_s, client.changed.set)
            if state.runs:
                from luxloop.loop.studio.stream import Stream  # which imports PyTorch, as the session has done by now

                client.stream = client.stream or Stream()
                messages = client.stream.messages(state, client.request)
                while (data := await self._loop.run_in_executor(self._threads, next, messages, None)) is not None:
                    client.busy_s = min(client.busy_s, time.monotonic())
                    await client.send(data)
                client.has_shown()
                if client.stream.rests_s > rests_s:  # newer steps may be waiting then
                    rests_s = client.stream.rests_s
                    self._loop.call_later(rests_s - time.perf_counter(), client.changed.set)


def _response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store", "Connection": "close"}
    headers |= {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
    return Response(status.value, status.phrase, Headers(headers), body)
