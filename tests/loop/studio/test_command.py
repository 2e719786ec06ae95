"""The command that serves the studio."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.server import Studio, Tokens
from tests.refusal import refusal

MAIN = "import sys; from luxloop.loop.commands.cli import main; sys.exit(main())"
STUDIO = [sys.executable, "-c", MAIN, "studio", "snowflake", "--port", "0"]


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 80_000), ("127.0.0.1", -1), ("a" * 300, 0), ("a\0", 0)])
def test_an_address_that_cannot_be_had_is_refused(host, port, tmp_path):
    async def serve() -> None:
        await Studio((), tmp_path, Tokens()).serve(host, port)

    with refusal(f"--port {port}: cannot listen there"):
        asyncio.run(serve())


@pytest.mark.skipif(not (PAGE / "index.html").is_file(), reason="the page is not built; make studio does that")
@pytest.mark.parametrize("before", [signal.SIG_DFL, signal.SIG_IGN], ids=["at a terminal", "in the background of a script"])
def test_sigterm_ends_it_and_no_argument_of_its_browser_tells_the_token(before, tmp_path):
    """A shell's background processes ignore SIGINT. The browser is one that runs in the terminal."""
    root, browser, opened = str(Path(__file__).parents[3]), tmp_path / "browser", tmp_path / "opened"
    browser.write_text(f"#!/bin/sh\necho $1 > {opened}.part; mv {opened}.part {opened}; exec sleep 60 > /dev/null 2>&1\n")
    browser.chmod(0o700)
    ready = subprocess.Popen(
        [*STUDIO, "--set", "renderer=raycast"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": root, "HOME": str(tmp_path), "BROWSER": f"{browser} %s"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, before),
    )
    assert ready.stdout is not None
    try:
        edit = next(line.split()[-1] for line in ready.stdout if line.startswith("To edit"))
        until_s = time.monotonic() + 60
        while not opened.is_file() and time.monotonic() < until_s:
            time.sleep(0.05)
        uri, file = opened.read_text().strip(), Path(unquote(urlsplit(opened.read_text().strip()).path))
        assert uri.startswith("file://") and edit in file.read_text() and file.parent.stat().st_mode & 0o077 == 0
        ready.send_signal(signal.SIGTERM)
        said = ready.communicate(timeout=120)[0]  # it ends once what is prepared is, at the latest
    finally:
        ready.kill()
    assert not file.parent.exists()
    assert ready.returncode == 130 and "Traceback" not in said
