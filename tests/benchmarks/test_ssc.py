"""The benchmark of SuperSampling Control runs, does the same work as what it is compared to, and writes its figures."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_quick_benchmark_writes_what_it_prints(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/ssc.py", "--quick", "--json", str(tmp_path / "ssc.json")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "not measured" in done.stdout or "cuda" in done.stdout
    results = json.loads((tmp_path / "ssc.json").read_text("utf-8"))
    text = json.dumps(results)
    assert all(part in text for part in ("product", "symbol", "many", "plain")), text[:400]
