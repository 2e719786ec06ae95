"""A studio that a program has begun: a real process, and a program that steers it."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from luxloop import LuxloopError, connect, load, prepare, show
from luxloop.loop.studio import page
from tests.loop.studio.conftest import SMALL
from tests.refusal import refusal

ROOT = Path(__file__).parents[3]

pytestmark = pytest.mark.skipif(not (page.PAGE / "index.html").is_file(), reason="the page is not built")


def test_a_simulation_is_shown_and_steered_and_ends_with_its_memory():
    simulation = prepare(load("snowflake", (*SMALL, "functions.symbol.x_m=16.0")), "cpu")
    with simulation.show() as shown:
        assert shown.address in shown._repr_html_() and shown.address in repr(shown) and shown.watch != shown.address
        before = set(Path("/dev/shm").glob("luxloop_*"))
        with connect(shown.address, shared=True) as client:
            assert client.scenario["name"] == "snowflake" and client.scenario["model"]["functions"]["symbol"]["x_m"] == 16.0
            assert client.step().step == 1
            shown.close()
            ended_s = time.monotonic() + 20  # what a busy machine takes
            with pytest.raises(LuxloopError):
                while time.monotonic() < ended_s:
                    client.step()
        assert set(Path("/dev/shm").glob("luxloop_*")) <= before
    assert shown._process.returncode is not None


@pytest.mark.slow
def test_a_program_beside_the_loop_holds_the_brightness_of_the_road():
    road = ("functions={}", "checks={}", "lighting.base.beam=off", "headlight.model=ssl-hd", "steps=10")
    with show("flat", *SMALL, *road) as shown:
        command = [sys.executable, str(ROOT / "scenarios/examples/lockstep.py"), shown.address, "7"]
        done = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    seen = [float(line.rpartition(" ")[2]) for line in done.stdout.splitlines()]
    assert len(seen) == 7 and seen[0] < 0.1 and abs(seen[-1] - 0.25) < 0.01, "0.042, then 0.249 in the seventh step"


def test_what_cannot_begin_is_told_in_a_sentence():
    with refusal("did you mean 'snowflake'"):
        show("snowflak")
    with refusal("did you mean 'bits'"):
        show("snowflake", "camera.bitz=8")
