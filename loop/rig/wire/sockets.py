"""Sockets at addresses of the user, and errors of addresses that cannot be used."""

import socket
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from urllib.parse import urlsplit

from luxloop.world.errors import LuxloopError

REFUSED = (OSError, OverflowError, UnicodeError, TypeError, ValueError)  # of invalid names, and ports in use or too large
STALLED_S = 5.0  # time-out of a client that does not read


@contextmanager
def refusing(what: str, remedy: str) -> Iterator[None]:
    """Raise LuxloopError `what (reason); remedy` if a socket cannot be opened."""
    try:
        yield
    except REFUSED as error:
        raise LuxloopError(f"{what} ({getattr(error, 'strerror', None) or error}); {remedy}") from error


def listening(key: str, host: str, port: int, remedy: str = "give another port") -> AbstractContextManager[None]:
    """Raise LuxloopError with key and address if a socket cannot listen there."""
    return refusing(f"{key}: cannot listen on {host}:{port}", remedy)


def reaching(key: str, where: str) -> AbstractContextManager[None]:
    """Raise LuxloopError with key and address if a socket cannot reach it."""
    return refusing(f"{key}: {where} cannot be reached", "check it, and the network")


def is_own_host(host: str, names: Collection[str] = ()) -> bool:
    """Whether a Host header names this machine; a foreign page whose name resolves to this machine has its own name there.

    names: further names of this machine.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    with suppress(ValueError):
        return bool(ip_address(name))
    return name in ("localhost", socket.gethostname().lower(), *names)


def udp_listener(key: str, host: str, port: int) -> socket.socket:
    """Listening UDP socket; port 0 is a free port. Raises LuxloopError if it cannot be opened."""
    with ExitStack() as stack, listening(key, host, port):
        found = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        found.bind((host, port))
        stack.pop_all()
    return found


def udp_sender(key: str, host: str, port: int) -> socket.socket:
    """UDP socket that sends to an address, broadcast included; a receiver need not exist. Raises LuxloopError if the address is invalid."""
    with reaching(key, host):
        found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        where = min(found, key=lambda each: each[0] != socket.AF_INET)  # devices on a network rarely have an IPv6 address
        sender = socket.socket(where[0], socket.SOCK_DGRAM)
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.settimeout(1.0)
        sender.connect(where[4])
    return sender


def serve_http(key: str, host: str, port: int, answer: Callable[[BaseHTTPRequestHandler], None]) -> ThreadingHTTPServer:
    """HTTP server in threads that answers GET requests; port 0 is a free port.

    Raises LuxloopError if the port cannot be opened.
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
