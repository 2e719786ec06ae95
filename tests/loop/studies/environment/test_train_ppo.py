"""The shipped program that learns: it runs to its comparison and its picture."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from luxloop.loop.scenario.shipped import examples

ROOT = Path(__file__).parents[4]


@pytest.mark.slow
def test_a_policy_is_learnt_and_compared(tmp_path):
    out = tmp_path / "learned.pt"
    command = [sys.executable, str(examples()["train_ppo.py"]), "--minutes", "0", "--worlds", "1", "--out", str(out)]
    told = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert out.is_file() and out.with_suffix(".png").is_file()
    assert [line.split()[0] for line in told.stdout.splitlines()[-3:]] == ["thesis_pid", "blind", "learned"]
