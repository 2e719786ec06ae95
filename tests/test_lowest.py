"""The least versions that the project allows are enough."""

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
PIP = [sys.executable, "-m", "pip", "install", "--quiet"]


def test_the_lowest_versions_that_the_project_allows_run_the_main_job(tmp_path):
    """With the torch of the constraints, since older ones are gigabytes that PyPI has with CUDA alone."""
    subprocess.run([*PIP, "--target", tmp_path / "uv", "uv"], check=True)
    (tmp_path / "override.txt").write_text(f"torch=={metadata.version('torch').partition('+')[0]}\n")
    lowest = ["--resolution", "lowest-direct", "--override", "override.txt", "--index-strategy", "unsafe-best-match"]
    compiled = [tmp_path / "uv/bin/uv", "pip", "compile", *lowest, "--quiet", "--python", sys.executable, "-o", "low.txt"]
    subprocess.run([*compiled, ROOT / "pyproject.toml"], cwd=tmp_path, check=True)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv/bin/python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-deps", "-r", "low.txt"], cwd=tmp_path, check=True)
    for arguments in (["run", "snowflake", "--steps", "2"], ["headlight", "show", "hd84", "--out", "lamp.png"]):
        command = [python, "-m", "luxloop.loop.commands.cli", *arguments]
        subprocess.run(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)
