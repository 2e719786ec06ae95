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
    out = tmp_path / "learned.png"
    command = [sys.executable, str(examples()["train_ppo.py"]), "--seeds", "2", "--steps", "1", "--worlds", "1", "--out", str(out)]
    told = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert sorted(each.name for each in tmp_path.iterdir()) == ["learned-0.zip", "learned-1.zip", "learned.png"]
    assert [line.split()[0] for line in told.stdout.splitlines()[-3:]] == ["thesis_pid", "blind", "learned"]
