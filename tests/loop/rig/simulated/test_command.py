"""`luxloop rig simulate` as a process of its own, started as the documentation says."""

import json
import re
import shlex
import shutil
import signal
import urllib.request

import pytest

from luxloop.loop.commands import cli
from luxloop.loop.scenario.shipped import examples
from tests.loop.rig.conftest import ROOT, SimulatedRigProcess

FREE = "--light-port 0 --camera-port 0 --truth-port 0"
SMALL = "headlight.model=ssl-hd-lores camera.width_px=160 camera.height_px=120 camera.oversampling=1 renderer=raycast"
DOCUMENTED = re.findall(r"^luxloop (rig simulate .*)$", (ROOT / "docs" / "rig.md").read_text("utf-8"), re.M)


def test_it_says_where_it_listens_and_ends_cleanly(tmp_path):
    with SimulatedRigProcess(["flat", "--set", *SMALL.split()], tmp_path) as rig:
        assert set(rig.addresses) == {"light", "camera", "truth"}
        with urllib.request.urlopen(rig.addresses["camera"], timeout=10) as answer:
            assert answer.readline() == b"--frame\r\n"
        assert json.load(urllib.request.urlopen(rig.addresses["truth"], timeout=10))["lit"] is False
        rig.process.send_signal(signal.SIGTERM)
        said, _ = rig.process.communicate(timeout=30)
    assert rig.process.returncode == 0
    assert re.fullmatch(r"\d+ frames exposed \(0 lost, \d+ skipped\), 0 frames of light \(0 incomplete\)\n", said)


@pytest.mark.slow
@pytest.mark.parametrize("command", DOCUMENTED)
def test_documented_commands_start_a_rig(command, tmp_path):
    for name in re.findall(r"\w+\.toml", command):
        shutil.copy(examples()[name], tmp_path)
    with SimulatedRigProcess(shlex.split(command)[2:], tmp_path) as rig:
        with urllib.request.urlopen(rig.addresses["camera"], timeout=10) as answer:
            assert answer.readline() == b"--frame\r\n"
        rig.process.send_signal(signal.SIGINT)
        assert rig.process.wait(30) == 0


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
def test_mistakes_are_one_sentence(arguments, message, capsys):
    assert cli.main(shlex.split(arguments)) == cli.WRONG
    said = capsys.readouterr()
    assert message in said.err and said.err.count("\n") == 1 and not said.out
