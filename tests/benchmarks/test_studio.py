"""The benchmark of the studio runs, and writes its figures."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from luxloop.loop.studio.page import PAGE

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(not (PAGE / "index.html").is_file(), reason="the page is not built: make studio")
def test_the_quick_benchmark_writes_what_watching_costs(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/studio.py", "--quick", "--json", str(tmp_path / "studio.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "studio.json").read_text("utf-8"))
    figures = results["scenarios"]["snowflake"]
    assert min(figures["unwatched"], figures["watched"], results["first_picture_s"]) > 0
    assert figures["messages"]["step"]["bytes"] > 1000
