"""The first run of docs/rig.md, word for word, against the rig process that it starts; only the ports are others."""

import os
import re
import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from luxloop.loop.rig.params import load_rig
from tests.loop.rig.conftest import ROOT, free_port

pytestmark = pytest.mark.slow


def test_the_first_run_of_the_page(tmp_path: Path) -> None:
    text = (ROOT / "docs/rig.md").read_text("utf-8")
    section = re.split(r"^## ", text, flags=re.M)[1]
    commands = [line for block in re.findall(r"^```sh\n(.*?)^```", section, re.M | re.S) for line in block.splitlines()]
    assert section.startswith("First run") and len(commands) == 6
    light, camera, truth = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM), free_port(socket.SOCK_STREAM)
    ports = ["--light-port", str(light), "--camera-port", str(camera), "--truth-port", str(truth)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    program = [sys.executable, "-m", "luxloop.loop.commands.cli"]
    arguments = shlex.split(commands[0])[1:]
    rig = subprocess.Popen([*program, *arguments, *ports], stdout=subprocess.PIPE, text=True, env=environment, cwd=tmp_path)
    try:
        assert rig.stdout is not None
        while "End it" not in (line := rig.stdout.readline()):
            assert line
        said = {}
        for command in commands[1:]:
            done = subprocess.run([*program, *shlex.split(command)[1:]], env=environment, cwd=tmp_path, capture_output=True, text=True)
            assert done.returncode == 0, f"{command}\n{done.stderr}"
            said[command.partition("luxloop ")[2]] = done.stdout
            if "new" in command:
                file = tmp_path / "rig.toml"
                text = file.read_text().replace("bits = 16", f"bits = 16\nport = {light}", 1).replace(":8080/", f":{camera}/")
                file.write_text(text)
        assert "the lamp stays dark" in next(out for name, out in said.items() if "runs/dry" in name)
        iou = re.search(r"as the camera sees it +IoU (0\.\d+)", next(out for name, out in said.items() if "runs/rig" in name))
        assert iou is not None and float(iou[1]) > 0.85
        timing = load_rig(tmp_path / "rig.toml").timing
        assert 0.02 < timing.latency_s < 0.1
    finally:
        rig.terminate()
        rig.wait(20)
