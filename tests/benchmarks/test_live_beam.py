"""The benchmark of the digitised beam runs, and keeps its goals."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_quick_benchmark_writes_rates_and_errors(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/live_beam.py", "--quick", "--json", str(tmp_path / "beam.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    coarse, fine = json.loads((tmp_path / "beam.json").read_text("utf-8"))["cases"]
    assert coarse["texels"] == [332, 1024] and fine["texels"] == [1328, 2048]
    assert coarse["ms"]["grey"] < 50 and coarse["error"]["smooth"] < 0.03  # 20 Hz and 3 %, the goals
