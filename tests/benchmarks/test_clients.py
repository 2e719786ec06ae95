"""The benchmark of the ways to programs beside the studio runs, and writes its figures."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_quick_benchmark_writes_what_both_ways_take(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/clients.py", "--quick", "--json", str(tmp_path / "clients.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (figures,) = json.loads((tmp_path / "clients.json").read_text("utf-8"))["pictures"].values()
    assert figures["bytes"] == 640 * 360 * 11 and min(figures["ms"].values()) > 0
