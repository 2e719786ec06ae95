"""How long commands take to start, in seconds of one core: `python benchmarks/startup.py`.

Each command runs in a process of its own, with one thread; the processor time of user and system counts. Rounds take the commands in turn,
and of each the median counts; the first leaves compiled modules for the others, as an installation does. `--before FOLDER` measures another
checkout in the same rounds.
"""

import os
import resource
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from bench import MESA, OMP, Goal, run, show

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


def seconds(checkout: Path, program: tuple[str, ...]) -> float:
    """Processor time in s of a program that imports from a checkout."""
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment = {**inherited, "PYTHONPATH": str(checkout), OMP: "1", MESA: "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", *program], cwd=folder, env=environment, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(given: Namespace) -> dict[str, Any]:
    checkouts = {"now": Path(__file__).parents[1]} | ({"before": given.before.resolve()} if given.before else {})
    taken: dict[str, dict[str, list[float]]] = {name: {which: [] for which in checkouts} for name in programs(given.quick)}
    for _ in range(1 if given.quick else given.rounds):
        for name, program in programs(given.quick).items():
            for which, checkout in checkouts.items():
                taken[name][which].append(seconds(checkout, program))
    found = {name: {which: median(values) for which, values in each.items()} for name, each in taken.items()}
    show("s of one core", {name: each | {"in imports of torch": each["now"] / found[TORCH]["now"]} for name, each in found.items()})
    return {
        "seconds": found,
        "goals": [Goal(f"s of {name}", found[name]["now"], LIMITS_S.get(name, LIMIT_S)) for name in list(found)[2:]],
    }


if __name__ == "__main__":
    rounds = {"type": int, "default": 5, "help": "rounds to take the median of (5)"}
    run(measure, __doc__, threads=(), rounds=rounds, before={"type": Path, "metavar": "FOLDER", "help": "another checkout, in turn"})
