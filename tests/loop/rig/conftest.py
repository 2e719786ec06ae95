"""Rigs as processes of their own, and rig files that name them."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from luxloop.loop.rig.params import RigParams
from luxloop.world.validation import validate_model

ROOT = Path(__file__).parents[3]
SMALL = Path(__file__).parent / "small_rig.py"
CALM_S = 10.0


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Process:
    """A small rig: its ports, and the process, which can be killed and started again."""

    def __init__(self, pixels: int, **keys: float) -> None:
        self.light, self.camera = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
        self.pixels, self.keys = pixels, keys
        self.start()

    def start(self, **keys: float) -> None:
        given = [f"{name}={value}" for name, value in (self.keys | keys).items()]
        command = [sys.executable, str(SMALL), str(self.light), str(self.camera), str(self.pixels), *given]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout is not None and self.process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def params(self, **tables: object) -> RigParams:
        """A rig file's tables, with others in their place."""
        timing = {"latency_s": 0.02, "jitter_s": 0.01, "rolling_s": 0.006, "wait_s": 0.6}
        light = {"kind": "ddp", "timecode": True, "host": "127.0.0.1", "port": self.light, "dark_after_s": self.keys.get("dark_s", 0.1)}
        camera = {"kind": "http", "url": f"http://127.0.0.1:{self.camera}/camera", "timeout_s": 0.3}
        return validate_model(RigParams, {"light": light, "camera": camera, "timing": timing, **tables}, "")


@pytest.fixture
def small_rig() -> Iterator[Callable[..., Process]]:
    """Starts small rigs, and ends them."""
    started: list[Process] = []

    def start(pixels: int = 192, **keys: float) -> Process:
        started.append(Process(pixels, **keys))
        return started[-1]

    yield start
    for each in started:
        each.kill()


def eventually(true: Callable[[], bool], seconds: float = CALM_S) -> bool:
    """Whether something comes true in some seconds."""
    until_s = time.monotonic() + seconds
    while not (found := true()) and time.monotonic() < until_s:
        time.sleep(0.01)
    return found
