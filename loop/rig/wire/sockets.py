"""Sockets at addresses that a user gave, and the refusal of those that cannot be had."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final

from luxloop.world.errors import LuxloopError

REFUSED: Final = (OSError, OverflowError, UnicodeError, TypeError)  # of a name that is none, a port that is taken or too large
STALLED_S: Final = 5.0  # after which a client that takes nothing is cut off


@contextmanager
def refusing(what: str, remedy: str) -> Iterator[None]:
    """Raises LuxloopError `what (reason); remedy` where a socket cannot be had."""
    try:
        yield
    except REFUSED as error:
        raise LuxloopError(f"{what} ({getattr(error, 'strerror', None) or error}); {remedy}") from error


def listening(key: str, host: str, port: int, remedy: str = "give another port") -> AbstractContextManager[None]:
    """Raises LuxloopError that names key and address where a socket cannot listen there."""
    return refusing(f"{key}: cannot listen on {host}:{port}", remedy)


def reaching(key: str, where: str) -> AbstractContextManager[None]:
    """Raises LuxloopError that names key and address where a socket cannot reach it."""
    return refusing(f"{key}: {where} cannot be reached", "check it, and the network")


def udp_listener(key: str, host: str, port: int) -> socket.socket:
    """A UDP socket that listens; a port of 0 takes a free one. Raises LuxloopError where it cannot be had."""
    with ExitStack() as stack, listening(key, host, port):
        found = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        found.bind((host, port))
        stack.pop_all()
    return found


def udp_sender(key: str, host: str, port: int) -> socket.socket:
    """A UDP socket that sends to an address, a broadcast too; nobody need listen there. Raises LuxloopError where there is none."""
    with reaching(key, host):
        found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        where = min(found, key=lambda each: each[0] != socket.AF_INET)  # devices on a network have no IPv6 address as a rule
        sender = socket.socket(where[0], socket.SOCK_DGRAM)
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.settimeout(1.0)
        sender.connect(where[4])
    return sender


def serve_http(key: str, host: str, port: int, answer: Callable[[BaseHTTPRequestHandler], None]) -> ThreadingHTTPServer:
    """An HTTP server in threads of its own, which answers each GET; a port of 0 takes a free one.

    Raises LuxloopError where the port cannot be had.
    """

    class Handler(BaseHTTPRequestHandler):
        timeout = STALLED_S

        def do_GET(self) -> None:
            answer(self)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with listening(key, host, port):
        server = ThreadingHTTPServer((host, port), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.1,), name=key, daemon=True).start()
    return server
