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
from luxloop.loop.commands.cli import main
from luxloop.loop.simulation.simulation import Simulation
step = Simulation.step
Simulation.step = lambda *arguments: os._exit(step(*arguments) is None)  # where the first step is done
main()
"""
CHECKS = ("snowflake", "speed_bump", "driving", "gfhb", "mechanical_bend", "night_drive")
TORCH = "import torch"
LIMITS_S = {"new my.toml": 1.0, "check snowflak": 1.0}  # the latter is mistyped
LIMIT_S = 3.0


def programs(quick: bool) -> dict[str, tuple[str, ...]]:
    """Programs and their arguments by name; files are written to the current folder."""
    checks = (f"check {name}" for name in (CHECKS[:1] if quick else CHECKS))
    commands = {name: (COMMAND, *name.split()) for name in ("--help", *LIMITS_S, *checks)}
    return {TORCH: (TORCH,), **commands, "run snowflake, to its first step": (FIRST_STEP, "run", "snowflake")}


def seconds(program: tuple[str, ...]) -> float:
    """Processor time in s of a program."""
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", *program], cwd=folder, env={**inherited, "PYTHONPATH": str(ROOT)}, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(given: Namespace) -> dict[str, Any]:
    rounds = [
        {name: seconds(program) for name, program in programs(given.quick).items()} for _ in range(1 if given.quick else given.rounds)
    ]
    found = medians(rounds)
    show("Start of commands", {name: {"s of one core": each, "in imports of torch": each / found[TORCH]} for name, each in found.items()})
    return {"seconds": found, "goals": [Goal(f"s of {name}", found[name], LIMITS_S.get(name, LIMIT_S)) for name in list(found)[2:]]}


if __name__ == "__main__":
    run(measure, __doc__, rounds={"type": int, "default": 5, "help": "rounds to take the median of (5)"})
