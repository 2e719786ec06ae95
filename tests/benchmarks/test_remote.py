"""The benchmark of a plant in another process runs, and writes its figures."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_quick_benchmark_writes_what_both_plants_take(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/remote.py", "--quick", "--json", str(tmp_path / "remote.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (figures,) = json.loads((tmp_path / "remote.json").read_text("utf-8"))["cases"]
    assert figures["frame_bytes"] == 2 * 2 * 640 * 360 and 0 < figures["light_bytes"] < 1e6
    assert figures["here_cpu_ms"] > 0 and figures["ms"] > 0
