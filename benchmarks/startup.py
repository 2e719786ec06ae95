"""How long commands take to start, in seconds of one core: `python benchmarks/startup.py`.

Each command runs in a process of its own, with one thread; the processor time of user and system counts. Rounds take the commands in turn,
and of each the median counts; the first leaves compiled modules for the others, as an installation does.
"""

import os
import resource
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench import Goal, medians, run, show

ROOT = Path(__file__).parents[1]
COMMAND = "import sys; from luxloop.loop.commands.cli import main; sys.exit(main())"
FIRST_STEP = """import os, sys
from luxloop import Simulation
from luxloop.loop.commands.cli import main
step = Simulation.step
Simulation.step = lambda *arguments: os._exit(step(*arguments) is None)  # where the first step is done
main()
"""
TORCH = "import torch"


def seconds(program: tuple[str, ...]) -> float:
    """Processor time in s of a program."""
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", *program], cwd=folder, env={**inherited, "PYTHONPATH": str(ROOT)}, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(given: Namespace) -> dict[str, Any]:
    programs = {TORCH: (TORCH,), **{name: (COMMAND, *name.split()) for name in ("--help", *given.limits_s)}}
    programs["run snowflake, to its first step"] = (FIRST_STEP, "run", "snowflake")
    found = medians([{name: seconds(program) for name, program in programs.items()} for _ in range(given.rounds)])
    show("Start of commands", {name: {"s of one core": each, "in imports of torch": each / found[TORCH]} for name, each in found.items()})
    return {"seconds": found, "goals": [Goal(f"s of {name}", found[name], given.limits_s.get(name, 4.0)) for name in list(found)[2:]]}


if __name__ == "__main__":
    run(measure, __doc__, "rounds")
