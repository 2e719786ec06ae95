"""`luxloop rig simulate` as a process of its own, started as the documentation says."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from luxloop.loop.commands import cli
from luxloop.loop.scenario.shipped import examples

ROOT = Path(__file__).parents[4]
MAIN = "import sys; from luxloop.loop.commands.cli import main; sys.exit(main())"
FREE = "--light-port 0 --camera-port 0 --truth-port 0"
SMALL = "headlight.model=ssl-hd-lores camera.width_px=160 camera.height_px=120 camera.oversampling=1 renderer=raycast"
DOCUMENTED = re.findall(r"^luxloop (rig simulate .*)$", (ROOT / "docs" / "rig.md").read_text("utf-8"), re.M)


@contextmanager
def started(command: str, folder: Path) -> Iterator[tuple[subprocess.Popen[str], dict[str, str]]]:
    """The process when it is ready, and its addresses."""
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, *shlex.split(command)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    addresses = dict[str, str]()
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("End it"):
                break
            addresses |= re.findall(r"^(\w+): +(\S+)", line)
        yield process, addresses
    finally:
        process.kill()
        process.wait()


def test_it_says_where_it_listens_and_ends_cleanly(tmp_path: Path) -> None:
    with started(f"rig simulate flat {FREE} --set {SMALL}", tmp_path) as (process, addresses):
        assert set(addresses) == {"light", "camera", "truth"}
        with urllib.request.urlopen(addresses["camera"], timeout=10) as answer:
            assert answer.readline() == b"--frame\r\n"
        assert json.load(urllib.request.urlopen(addresses["truth"], timeout=10))["lit"] is False
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert re.fullmatch(r"\d+ frames exposed \(0 lost, \d+ skipped\), 0 frames of light \(0 incomplete\)\n", said)


@pytest.mark.slow
@pytest.mark.parametrize("command", DOCUMENTED)
def test_documented_commands_start_a_rig(command: str, tmp_path: Path) -> None:
    for name in re.findall(r"\w+\.toml", command):
        shutil.copy(examples()[name], tmp_path)
    scenario, _, rest = command.removeprefix("rig simulate ").partition(" ")
    with started(f"rig simulate {scenario} {FREE} {rest}", tmp_path) as (process, addresses):
        with urllib.request.urlopen(addresses["camera"], timeout=10) as answer:
            assert answer.readline() == b"--frame\r\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("rig simulate flat --set faults.lens.blurr_px=1", "--set faults.lens.blurr_px=1: lens.blurr_px: unknown key"),
        ("rig simulate flat --ego here:²", "--ego here:²: is no address; write HOST:PORT"),
        (f"rig simulate flat {FREE} --set {SMALL} --host {'a' * 100}", "--camera-port 0: cannot listen on"),
        (f"rig simulate flat {FREE} --set {SMALL} faults.camera.encoding=jpeg", "JPEG has 8 bits and the camera 12"),
        (f"rig simulate flat {FREE} --set {SMALL} faults.lens.coefficients=[-9]", "lens.coefficients: [-9.0] fold the picture"),
    ],
)
def test_mistakes_are_one_sentence(arguments: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(shlex.split(arguments)) == cli.WRONG
    said = capsys.readouterr()
    assert message in said.err and said.err.count("\n") == 1 and not said.out
