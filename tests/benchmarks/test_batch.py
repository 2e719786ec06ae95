"""The benchmark of copies at once runs, and writes its figures."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_quick_benchmark_writes_what_copies_take(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/batch.py", "--quick", "--json", str(tmp_path / "batch.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (size,) = json.loads((tmp_path / "batch.json").read_text("utf-8"))["sizes"]
    assert size["4"]["ratio"] > 0 and size["4"]["step"] > size["4"]["judge"] > 0
