"""The benchmark of the ground's plane runs, writes what it prints, and agrees with closed forms."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from ground import AHEAD_M, STRAIGHT_M, VEHICLE, hills, off_mm

from luxloop.world.roads.shapes import GradeParams, Profile

ROOT = Path(__file__).parents[2]


def test_the_quick_benchmark_writes_what_it_prints(tmp_path: Path) -> None:
    command = [sys.executable, "benchmarks/ground.py", "--quick", "--json", str(tmp_path / "ground.json")]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "ground.json").read_text("utf-8"))["rms_mm"]
    near, far = found["50 m"]["class C"]
    assert f"**{near:.0f}, {far:.0f}**" in done.stdout
    for row in found.values():  # the same surface, whose heights are as the roots of the classes' densities: 1 to 2 to 4
        assert np.divide(row["class D"], row["class B"]) == pytest.approx([4.0, 4.0])


def test_a_grade_without_end_lies_on_the_plane_and_five_percent_above_a_level_one() -> None:
    grade = Profile(grades=(GradeParams(x_m=0.0, percent=5.0, curve_m=1.0),))
    assert off_mm(grade, 50.0, 300.0) == pytest.approx(0.0, abs=1e-6)  # mm^2; rounding of heights of 15 m
    rises = [(50.0 * (x - VEHICLE.rear_x_m)) ** 2 for x in AHEAD_M]
    assert off_mm(grade, None, 300.0).mean(1) == pytest.approx(rises)


def test_hills_have_curves_of_their_radius() -> None:
    x = np.arange(300.0, 1000.0, 0.5)
    bend = np.gradient(np.gradient(hills(1000.0, 1000.0).z(x, 0 * x), x), x)
    assert abs(bend).max() == pytest.approx(1e-3, rel=1e-6)
    straight = (abs(bend) < 1e-9).mean()
    assert straight == pytest.approx(STRAIGHT_M / (STRAIGHT_M + 100.0), abs=0.06)  # 4.2 periods of 165 m, whose ends count
