"""The command that serves the studio."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from loop.studio.page import PAGE

MAIN = "import sys; from loop.commands.cli import main; sys.exit(main())"
STUDIO = [sys.executable, "-c", MAIN, "studio", "snowflake", "--port", "0"]

BROWSER = "sh -c 'exec sleep 300 >/dev/null 2>&1' %s"  # in the foreground, as those of a terminal are


@pytest.mark.skipif(not (PAGE / "index.html").is_file(), reason="the page is not built; make studio does that")
@pytest.mark.parametrize("before", [signal.SIG_DFL, signal.SIG_IGN], ids=["at a terminal", "in the background of a script"])
def test_sigterm_ends_it(before: signal.Handlers, tmp_path: Path) -> None:
    """A shell's background processes ignore SIGINT."""
    root = str(Path(__file__).parents[3])
    ready = subprocess.Popen(
        [*STUDIO, "--set", "renderer=raycast"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": root, "BROWSER": BROWSER},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, before),
    )
    assert ready.stdout is not None
    try:
        for line in ready.stdout:
            if re.match("End it", line):
                break
        ready.send_signal(signal.SIGTERM)
        said = ready.communicate(timeout=120)[0]  # it ends once what is prepared is, at the latest
    finally:
        ready.kill()
    assert ready.returncode == 130 and "Traceback" not in said
