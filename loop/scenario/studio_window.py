"""The studio beside a notebook or a program, in a process of its own, which owns the OpenGL context."""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Self

from luxloop.loop.scenario.edits import with_overrides
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.scenario.text import scenario_text
from luxloop.world.errors import LuxloopError
from luxloop.world.plugin import own_names

HEIGHT_PX: Final = 720
PATIENCE_S: Final = 10.0  # for the process to end
SERVE: Final = """
import os, signal, sys, threading
threading.Thread(target=lambda: (sys.stdin.read(), os.kill(os.getpid(), signal.SIGTERM)), daemon=True).start()
from luxloop.loop.commands.cli import main
sys.exit(main(sys.argv[1:]))
"""  # the process ends when its standard input closes, with the program that started it


def show(scenario: Scenario | str, /, *overrides: str, device: str = "auto") -> "StudioWindow":
    """Watch and steer a scenario in the page of `luxloop studio`, from step 0 on; a notebook shows the page in a frame.

    scenario: a loaded one, or its name or path. overrides: other values of its keys, as KEY=VALUE. device: "auto", "cpu" or "cuda".
    The studio runs in a process of its own until `close()` or until the program ends. Raises LuxloopError where the studio cannot start.
    """
    return StudioWindow(with_overrides(load(scenario) if isinstance(scenario, str) else scenario, overrides), device)


class StudioWindow:
    """A running studio, as `show` returns it; a context manager that ends the studio.

    address: of the page for editing, which `luxloop.connect` takes as well. watch: of the page for watching only.
    """

    def __init__(self, scenario: Scenario, device: str) -> None:
        self._folder = TemporaryDirectory(prefix="luxloop_")
        file, log = Path(self._folder.name, "shown.toml"), Path(self._folder.name, "log")
        file.write_text(scenario_text(scenario), "utf-8")
        command = [sys.executable, "-c", SERVE, "studio", str(file), "--no-open", "--port", "0", "--device", device]
        command += ["--allow-code"] if any(own_names(scenario)) else []
        with log.open("w") as errors:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True
            )
        found = {}
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("To "):
                found[line.split()[1].rstrip(":")] = line.split()[-1]
            if "watch" in found:
                break
        if "watch" not in found:
            text = log.read_text("utf-8")
            self.close()
            raise LuxloopError(f"show: the studio did not begin ({' '.join(text.split())[-300:]})")
        self.address, self.watch = found["edit"], found["watch"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the studio."""
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def __repr__(self) -> str:
        return f"<studio at {self.address}>"

    def _repr_html_(self) -> str:
        """The page in a frame."""
        return f'<iframe src="{self.address}" width="100%" height="{HEIGHT_PX}" style="border: 0"></iframe>'
