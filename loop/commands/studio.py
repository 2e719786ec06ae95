"""The command that serves the studio."""

import asyncio
import ctypes
import os
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Annotated

from luxloop.loop.commands.options import INTERRUPTED, AllowCode, Device, Keys, within

M_ARENA_MAX = -8  # of glibc's malloc


def studio(
    scenario: str = "snowflake",
    beside: str | None = None,
    /,
    *,
    set: Keys = None,
    host: str = "127.0.0.1",
    port: Annotated[int, within(gte=0, lte=65535)] = 8765,
    open: bool = True,
    allow_code: AllowCode = False,
    device: Device = "auto",
) -> None:
    """Watch and steer a loop in the browser while it runs: the scene in 3-D, the camera, the pixels and the curves.

    Parameters
    ----------
    scenario
        Shipped name (see `luxloop list`), path of a scenario, or folder of a recording.
    beside
        A second one, which steps beside the first in the same views.
    set
        Other values of keys, as KEY=VALUE in TOML, or a .toml file of keys.
    host
        Address to listen on; with an address other than 127.0.0.1, other machines can open the page with a token.
    port
        Port to listen on, 0 for a free one.
    open
        Whether the page is opened in the browser.
    device
        Where torch computes.
    """
    from luxloop.loop.studio.page import page
    from luxloop.loop.studio.server import Studio, Tokens
    from luxloop.loop.studio.sources import Source

    with suppress(AttributeError, OSError):  # another libc
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)  # the simulation's thread would leave 250 MB of holes in an arena of its own
    overrides, files, tokens = tuple(set or ()), page(), Tokens()
    sources = tuple(
        Source("", overrides, Path(name)) if Path(name).is_dir() else Source(name, overrides) for name in (scenario, beside) if name
    )

    async def serve() -> None:
        served = Studio(sources, files, tokens, allow_code=allow_code, device=device)
        server = await served.serve(host, port)
        reached = socket.gethostname() if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
        address = f"http://{reached}:{server.sockets[0].getsockname()[1]}/"
        print(f"To edit:  {address}#{tokens.edit}\nTo watch: {address}#{tokens.watch}\nEnd it with Ctrl-C.", flush=True)
        ends, opened = asyncio.current_task(), ExitStack()
        with suppress(NotImplementedError):
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ends.cancel if ends else served.stop)
        try:
            if open:
                opened.enter_context(in_browser(f"{address}#{tokens.edit}"))
            await server.serve_forever()
        finally:
            opened.close()
            server.close()
            await server.wait_closed()
            if not served.stop():  # Python aborts where a thread is within PyTorch at its end
                print("interrupted", file=sys.stderr, flush=True)
                os._exit(INTERRUPTED)

    try:
        asyncio.run(serve())
    except asyncio.CancelledError:  # SIGTERM ends it as Ctrl-C does, also where a shell lets it ignore Ctrl-C
        raise KeyboardInterrupt from None


@contextmanager
def in_browser(address: str) -> Iterator[None]:
    """Open an address in the browser through a private file that exists during the block, since all users see a browser's arguments.

    The file is in the home folder, where browsers in a sandbox can read it. The block does not wait for a browser in the terminal.
    """
    home = os.path.expanduser("~")
    with tempfile.TemporaryDirectory(prefix="luxloop-studio-", dir=home if os.access(home, os.W_OK) else None) as folder:
        file = Path(folder, "open.html")
        file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
        threading.Thread(target=webbrowser.open, args=[file.as_uri()], daemon=True).start()
        yield
