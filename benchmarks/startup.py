"""How long commands take to start, in seconds of one core: `python benchmarks/startup.py`.

Each command runs in a process of its own, with one thread; the processor time of user and system counts. Rounds take the commands in turn,
and of each the median counts; the first leaves compiled modules for the others, as an installation does. `--before FOLDER` measures another
checkout in the same rounds.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from bench import Goal, judged, machine, show_goals

from luxloop.loop.report import terminal as tables

HERE = Path(__file__).parents[1]
COMMAND = "import sys; from luxloop.loop.commands.cli import main; sys.exit(main())"
FIRST_STEP = """import os, sys
from luxloop.loop.commands.cli import main
from luxloop.loop.simulation.simulation import Simulation
step = Simulation.step
Simulation.step = lambda *arguments: os._exit(step(*arguments) is None)  # where the first step is done
main()
"""
NEW, MISTYPED, TORCH = "luxloop new", "luxloop check snowflak, mistyped", "import torch alone"
CHECKED = ("snowflake", "speed_bump", "driving", "gfhb", "mechanical_bend", "night_drive")
QUICK_CHECKED = ("snowflake",)


def commands(scenarios: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Programs and arguments of all that is measured, by name; files are written to the current folder."""
    return {
        TORCH: ("import torch",),
        "luxloop --help": (COMMAND, "--help"),
        NEW: (COMMAND, "new", "my.toml"),
        MISTYPED: (COMMAND, "check", "snowflak"),
        **{f"luxloop check {name}": (COMMAND, "check", name) for name in scenarios},
        "luxloop run snowflake, to its first step": (FIRST_STEP, "run", "snowflake"),
    }


def seconds(checkout: Path, program: str, arguments: tuple[str, ...]) -> float:
    """Processor time in s of a program that imports from a checkout."""
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment = {**inherited, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", program, *arguments], cwd=folder, env=environment, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(scenarios: tuple[str, ...], rounds: int, before: Path | None) -> dict[str, dict[str, float]]:
    """Median s of each command, `now` and, of another checkout, `before`."""
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    checkouts = {"now": HERE, **({} if before is None else {"before": before.resolve()})}
    for _ in range(rounds):
        for name, (program, *arguments) in commands(scenarios).items():
            for which, checkout in checkouts.items():
                found[name][which].append(seconds(checkout, program, tuple(arguments)))
    return {name: {which: median(values) for which, values in each.items()} for name, each in found.items()}


def goals(found: dict[str, dict[str, float]]) -> list[Goal]:
    limits = {NEW: 1.0, MISTYPED: 1.0}
    return [
        (f"{name}, s", each["now"], limits.get(name, 3.0), False) for name, each in found.items() if name not in (TORCH, "luxloop --help")
    ]


def main() -> None:
    """Measure, show."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--rounds", type=int, default=5, help="rounds to take the median of (5)")
    parser.add_argument("--before", type=Path, metavar="FOLDER", help="another checkout, measured in turn")
    parser.add_argument("--quick", action="store_true", help="one round of few commands, to see that it works")
    arguments = parser.parse_args()
    console, where = tables.console(), machine("torch", "pydantic")
    console.print(", ".join(f"{key} {value}" for key, value in where.items()), markup=False)
    rounds, scenarios = (1, QUICK_CHECKED) if arguments.quick else (arguments.rounds, CHECKED)
    found = measure(scenarios, rounds, arguments.before)
    rows = [
        (name, *(f"{each[which]:.2f}" for which in ("before", "now") if which in each), f"{each['now'] / found[TORCH]['now']:.2f}")
        for name, each in found.items()
    ]
    columns = ("s of one core", *(() if arguments.before is None else ("before",)), "now", "now, in imports of torch")
    console.print(tables.plain(columns, rows, "lr"))
    show_goals(console, judged(goals(found)))
    if arguments.json:
        report: dict[str, Any] = {"machine": where, "rounds": rounds, "seconds": found, "goals": judged(goals(found))}
        arguments.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
