"""Rigs as processes of their own, and rig files that name them."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Self

import pytest

from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.rig import Rig
from luxloop.world.validation import validate_model

ROOT = Path(__file__).parents[3]
SMALL = Path(__file__).parent / "small_rig.py"
PROGRAM = [sys.executable, "-m", "luxloop.loop.commands.cli"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
CALM_S = 10.0
DDP = {"kind": "ddp", "timecode": True, "host": "127.0.0.1"}
FILE = """
[light]
kind = "ddp"
timecode = true
host = "127.0.0.1"
port = {light}

[camera]
kind = "http"
url = "{url}"

[timing]
latency_s = 0.03
jitter_s = 0.02  # measured
"""

WHOLE = """
[light]
kind = "ddp"
host = "192.168.1.20"

[camera]
kind = "http"
url = "http://192.168.1.21:8080/camera"
"""


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Child:
    """A process of its own, which can be killed."""

    process: subprocess.Popen[str]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


class Process(Child):
    """A small rig: its ports, and the process, which can be killed and started again."""

    def __init__(self, pixels: int, **keys: float) -> None:
        self.light, self.camera = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
        self.pixels, self.keys = pixels, keys
        self.start()

    def start(self, **keys: float) -> None:
        given = [f"{name}={value}" for name, value in (self.keys | keys).items()]
        command = [sys.executable, str(SMALL), str(self.light), str(self.camera), str(self.pixels), *given]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT)
        assert self.process.stdout is not None and self.process.stdout.readline() == "ready\n"

    def file(self, folder: Path, more: str = "", url: str = "http://127.0.0.1:{camera}/camera") -> str:
        """A rig file that names it, and ends with [timing] and more."""
        (file := folder / "rig.toml").write_text(FILE.format(light=self.light, url=url.format(camera=self.camera)) + more)
        return str(file)

    def params(self, **tables: object) -> RigParams:
        """A rig file's tables, with others in their place."""
        timing = {"latency_s": 0.02, "jitter_s": 0.01, "rolling_s": 0.006, "wait_s": 0.6}
        light = {**DDP, "port": self.light, "dark_after_s": self.keys.get("dark_s", 0.1)}
        camera = {"kind": "http", "url": f"http://127.0.0.1:{self.camera}/camera", "timeout_s": 0.3}
        return validate_model(RigParams, {"light": light, "camera": camera, "timing": timing, **tables}, "")


Start = Callable[..., Process]


@pytest.fixture
def small_rig() -> Iterator[Start]:
    """Starts small rigs, and ends them."""
    with ExitStack() as stack:
        yield lambda pixels=192, **keys: stack.enter_context(Process(pixels, **keys))


class SimulatedRigProcess(Child):
    """`luxloop rig simulate` as a process of its own, when it is ready: its ports and addresses, and what it says of frames."""

    def __init__(self, arguments: Sequence[str], folder: Path, ports: tuple[int, int, int] | None = None) -> None:
        """ports: of light, camera and truth; left out: free ones."""
        kinds = socket.SOCK_DGRAM, socket.SOCK_STREAM, socket.SOCK_STREAM
        self.light, self.camera, self.port = ports or [free_port(kind) for kind in kinds]
        given = ("--light-port", str(self.light), "--camera-port", str(self.camera), "--truth-port", str(self.port))
        command = [*PROGRAM, "rig", "simulate", *arguments, *given]
        ctrl_c = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT, cwd=folder, preexec_fn=ctrl_c)
        self.addresses = dict[str, str]()
        while "End it" not in (line := self.process.stdout.readline()):
            assert line, "the rig has not started"
            self.addresses |= re.findall(r"^(\w+): +(\S+)", line)

    def wrong(self, taken: Sequence[tuple[int, int, float]]) -> list[Any]:
        """Frames that show something else than the light for which they were taken: time code, CRC-32 of the picture, time of arrival."""
        told, found = json.load(urllib.request.urlopen(f"http://127.0.0.1:{self.port}/truth", timeout=20))["frames"], []
        for code, crc, arrived_s in taken:
            same = [each for each in told if each["crc32"] == crc]  # dark pictures may be equal
            assert same
            sent = min(same, key=lambda each: abs(arrived_s - each["sent_s"]))
            if sent["timecodes"] != [code]:
                found.append((code, sent["timecodes"], arrived_s - sent["exposed_from_s"], arrived_s - sent["sent_s"]))
        return found


def watch_frames(rig: Rig) -> list[tuple[int, int, float]]:
    """Which picture a rig takes for which light from now on: time code, CRC-32 of the picture, and when it arrived."""
    taken, expose, light = list[tuple[int, int, float]](), rig.expose, rig.light

    def watched(*given: Any) -> Any:
        limited, frame = expose(*given)
        if frame.image is not None:
            taken.append((light.timecode, zlib.crc32(frame.data), frame.arrived_s))
        return limited, frame

    rig.expose = watched  # type: ignore[method-assign]
    return taken


def eventually(true: Callable[[], bool], seconds: float = CALM_S) -> bool:
    """Whether something comes true in some seconds."""
    until_s = time.monotonic() + seconds
    while not (found := true()) and time.monotonic() < until_s:
        time.sleep(0.01)
    return found


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    file = tmp_path / "rig.toml"
    file.write_text(WHOLE)
    return file
