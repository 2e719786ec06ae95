"""The benchmark of devices runs where there is no CUDA device, and writes its figures."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_quick_benchmark_writes_a_figure_for_each_device(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/devices.py", "--quick", "--json", str(tmp_path / "devices.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "devices.json").read_text("utf-8"))
    rates = [*results["rollouts"].values(), {key: each["ms"] for key, each in results["runs"]["snowflake, thesis_pid"].items()}]
    assert all("cpu" in each and min(each.values()) > 0 for each in rates)
