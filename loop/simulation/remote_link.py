"""The socket at which the loop waits for a simulator that is its plant, and talks with it in lockstep."""

import re
import socket
import struct
import threading
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from queue import Empty, SimpleQueue
from typing import Any, Final

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from luxloop.loop.simulation.remote_answers import PROTOCOL, Answer, Failed, Hello, Message, largest, read
from luxloop.world.errors import LuxloopError
from luxloop.world.messages import ArrayBytes, Arrays, pack

GREET_S: Final = 10.0  # in which a program that has connected must say hello
CLOSE_S: Final = 1.0  # in which it must answer the end of its connection
LOOK_S: Final = 0.5  # between two looks at whether Python ends
REFUSED: Final = 4400  # code by which a connection is closed whose program breaks the protocol
BUSY: Final = 4409  # code by which it is closed where another simulator is the plant
HERE: Final = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")  # pages that this machine serves


class Link:
    """One simulator, for as long as both want. timeout_s: for which the loop waits for it to connect, and for each of its answers. size:
    height and width of its frames.
    """

    def __init__(self, address: str, timeout_s: float, size: tuple[int, int]) -> None:
        self.address, self._timeout_s, self._size = address, timeout_s, size
        self._opened, self._ending, self._over = ExitStack(), threading.Event(), threading.Event()
        self._met: tuple[ServerConnection, str] | None = None  # with its name

    def meet(self, welcome: Mapping[str, Any]) -> None:
        """Wait for a simulator, and welcome it; the one that is there stays. Raises LuxloopError where none comes, or the address cannot
        be had.
        """
        if self._met is not None:
            return
        came, refused = SimpleQueue[tuple[ServerConnection, str]](), list[str]()
        self._listen(came, refused)
        try:
            self._met = came.get(timeout=self._timeout_s)
        except Empty:
            self.close()
            others = f"; refused: {refused[-1]}" if refused else ""
            raise LuxloopError(
                f"no simulator has connected to ws://{self.address} within {self._timeout_s:g} s; start one, or raise "
                f"plant.timeout_s{others}"
            ) from None
        self._send({"type": "welcome", "protocol": PROTOCOL, **welcome})

    def ask(self, head: Mapping[str, Any], arrays: Mapping[str, ArrayBytes] | None = None) -> tuple[Answer, Arrays]:
        """Send a message, and wait for the arrivals that answer it by the same `number`.

        Raises LuxloopError where the simulator goes away, does not answer in time, breaks the protocol, or says that it fails; the
        connection is closed then.
        """
        self._send(head, arrays)
        assert self._met is not None
        connection, name = self._met
        try:
            message, frames = _received(connection, self._timeout_s, self._size)
            if isinstance(message, Failed):
                self.close()
                raise LuxloopError(f"{name}: fails ({message.text})")
            if not isinstance(message, Answer) or message.number != head.get("number"):
                number = f" of exposure {message.number}" if isinstance(message, Answer) else ""
                raise LuxloopError(f"gives {message.type}{number}, but was asked for arrivals with number {head.get('number')}")
        except TimeoutError as error:
            raise self._broken(f"does not answer within {self._timeout_s:g} s; raise plant.timeout_s if it needs longer") from error
        except ConnectionClosed as error:
            raise self._broken(f"has gone ({error})") from error
        except LuxloopError as error:
            raise error if self._met is None else self._broken(str(error)) from error
        return message, frames

    def close(self, text: str = "") -> None:
        """End the connection, and tell the simulator that the run is over, or what is wrong with it."""
        self._ending.set()
        met, self._met = self._met, None
        if met is not None:
            _dismiss(met[0], {"type": "error", "text": text} if text else {"type": "end"}, REFUSED if text else 1000)
        self._over.set()
        self._opened.close()

    def _listen(self, came: SimpleQueue[tuple[ServerConnection, str]], refused: list[str]) -> None:
        """Put the first simulator that comes into a queue, and what is wrong with other programs into a list."""
        host, _, port = self.address.rpartition(":")
        size, ending, over, taken = self._size, threading.Event(), threading.Event(), threading.Lock()
        seconds, rest = divmod(self._timeout_s, 1)
        send_timeout = struct.pack("@ll", int(seconds), int(1e6 * rest))  # of the socket alone: one in Python would end the reading, too

        def greet(connection: ServerConnection) -> None:
            try:
                connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, send_timeout)
                hello, _ = _received(connection, GREET_S, size)
                if not isinstance(hello, Hello) or hello.protocol != PROTOCOL:
                    raise LuxloopError(f"a program must first say hello, with protocol {PROTOCOL}")
            except (LuxloopError, OSError, ConnectionClosed) as error:
                refused.append(str(error) or "a program said nothing")
                _dismiss(connection, {"type": "error", "text": refused[-1]}, REFUSED)
                return
            if ending.is_set():  # it comes again for the next run
                return
            if not taken.acquire(blocking=False):
                _dismiss(connection, {"type": "error", "text": "another simulator is the plant of this run"}, BUSY)
                return
            came.put((connection, hello.name))
            while not over.wait(LOOK_S) and threading.main_thread().is_alive():
                pass

        try:
            server = serve(
                greet,
                host.strip("[]"),
                int(port),
                origins=[None, HERE],
                compression=None,
                open_timeout=GREET_S,
                ping_interval=None,  # a simulator may be at work for longer
                close_timeout=CLOSE_S,
                max_size=largest(size),
                max_queue=2,
                family=socket.AF_INET6 if ":" in host else socket.AF_INET,
            )
        except (OSError, OverflowError, UnicodeError) as error:
            raise LuxloopError(
                f"cannot listen on {self.address} ({getattr(error, 'strerror', None) or error}); set plant.address to another port"
            ) from error
        self._ending, self._over = ending, over
        self._opened.callback(server.shutdown)
        threading.Thread(target=server.serve_forever, name="remote plant", daemon=True).start()

    def _send(self, head: Mapping[str, Any], arrays: Mapping[str, ArrayBytes] | None = None) -> None:
        if self._met is None:
            raise LuxloopError("no simulator is connected any more; start the run anew")
        try:
            self._met[0].send(pack(head, arrays))
        except ConnectionClosed as error:
            raise self._broken(f"has gone, or does not read within {self._timeout_s:g} s ({error})") from error

    def _broken(self, text: str) -> LuxloopError:
        name = "" if self._met is None else f"{self._met[1]}: "
        self.close(text)
        return LuxloopError(f"{name}{text}")


def _received(connection: ServerConnection, timeout_s: float, size: tuple[int, int]) -> tuple[Message, Arrays]:
    return read(connection.recv(timeout_s), size)


def _dismiss(connection: ServerConnection, head: Mapping[str, Any], code: int) -> None:
    with suppress(ConnectionClosed):
        connection.send(pack(head))
    connection.close(code)
