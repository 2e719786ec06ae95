"""Damaged files of every kind end in success or in one sentence: no traceback, no abort, within 4 GB and 20 s.

A case follows from its number: `python -m tests.fuzz.worker N N+1 EVERY` tries case N again.
"""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FEW = 600  # cases of the fast test: each kind is among them three times or more


def tried(first: int, last: int, every: int) -> list[str]:
    """What went wrong in the cases of these numbers; one that ends its process is followed by those after it."""
    wrong: list[str] = []
    while first < last:
        command = [sys.executable, "-m", "tests.fuzz.worker", str(first), str(last), str(every)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, errors="replace")
        wrong += [each.split("\ncase ")[0] for each in re.split(r"^(?=wrong )", done.stdout, flags=re.M)[1:]]
        if done.stdout.endswith("done\n"):
            break
        cases = re.findall(r"^case (\d+) (.*)$", done.stdout, re.M)
        assert cases, done.stderr
        number, kind = cases[-1]
        reason = signal.Signals(-done.returncode).name if done.returncode < 0 else done.stderr[-2000:]
        wrong.append(f"ended {number} {kind}: {reason}")  # SIGPROF: more than 20 s of processor time, SIGALRM: it hangs
        first = int(number) + 1
    return wrong


def test_six_hundred_damaged_files():
    wrong = tried(0, FEW, every=0)
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_twenty_thousand_damaged_files_and_scenarios_that_are_built():
    wrong = tried(FEW, 20_000 + FEW, every=50)
    assert not wrong, "\n".join(wrong)
