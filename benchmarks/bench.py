"""The harness of the benchmarks: options, one thread, the machine, steps timed in turn, resumable studies, goals, tables, JSON."""

import argparse
import datetime
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import torch

from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.report.terminal import markdown_table, number
from luxloop.loop.studies.jobs import Job, Values, digest_of, local
from luxloop.loop.studies.jobs import run as run_jobs

OMP, MESA, BLAS = "OMP_NUM_THREADS", "LP_NUM_THREADS", "OPENBLAS_NUM_THREADS"
GPU_ROUNDS, GPU_WARM_UPS = 500, 10  # as in the thesis
Step = Callable[[], Any]


class Goal(NamedTuple):
    """value: None where it is not measured. least: the limit is a lower bound. where: the case that the value is of."""

    what: str
    value: float | None
    limit: float
    least: bool = False
    where: str = ""

    @property
    def passed(self) -> bool | None:
        return None if self.value is None else bool(self.value >= self.limit if self.least else self.value <= self.limit)


def run(
    measure: Callable[[argparse.Namespace], dict[str, Any]],
    about: str | None,
    *,
    packages: Sequence[str] = ("torch",),
    threads: Sequence[str] = (OMP, MESA),
    **options: Mapping[str, Any],
) -> None:
    """A benchmark's program: parses `--json`, `--quick` and the options, measures on one thread, prints goals, writes JSON.

    measure: of the arguments; prints its tables and returns what JSON gets, with `goals`, a sequence of Goal, and `failures`, reasons by
    key, where it has them. threads: environment variables that libraries read at their start. options: arguments of `add_argument` by name.
    """
    if any(os.environ.get(name) != "1" for name in threads):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **dict.fromkeys(threads, "1")})
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--quick", action="store_true", help="a small case")
    for name, option in options.items():
        parser.add_argument(f"--{name}", **option)
    given = parser.parse_args()
    torch.set_num_threads(1)
    where = machine(*packages)
    print(", ".join(f"{key} {value}" for key, value in where.items()))
    found = measure(given)
    if goals := list(found.get("goals", ())):
        show("Goals", {goal.what: verdict(goal) for goal in goals})
        found["goals"] = [each._asdict() | {"passed": each.passed} for each in goals]
    if given.json:
        given.json.write_text(json.dumps({"machine": where, **found}, indent=1) + "\n", "utf-8")
    if failures := found.get("failures"):
        sys.exit("\n".join(f"failed: {key}: {reason}" for key, reason in failures.items()))


def verdict(goal: Goal) -> dict[str, str]:
    """A row of the table of goals."""
    value = "not measured" if goal.value is None else f"{goal.value:.3g}" + (f" ({goal.where})" if goal.where else "")
    passed = {True: "reached", False: "**missed**", None: ""}[goal.passed]
    return {"measured": value, "limit": f"{'≥' if goal.least else '≤'} {goal.limit:g}", "": passed}


def show(title: str, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table as Markdown: values by column by row. A mapping in place of a value makes a column of each of its values."""
    flat = {name: dict(_flat(row)) for name, row in rows.items()}
    columns = list(dict.fromkeys(column for row in flat.values() for column in row))
    cells = ((name, *(_cell(row.get(column)) for column in columns)) for name, row in flat.items())
    print(f"\n{title}\n\n{markdown_table(('', *columns), cells)}", flush=True)


def _flat(row: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name} ")
        else:
            yield prefix + name, value


def _cell(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_cell, value))
    return number(value, ".3g" if abs(value) < 1000 else ",.0f") if isinstance(value, float) else "–" if value is None else str(value)


def machine(*packages: str) -> dict[str, str]:
    """Date, hardware and versions of a measurement."""
    info = Path("/proc/cpuinfo")
    models = [line.split(":", 1)[1].strip() for line in (info.read_text().splitlines() if info.exists() else ()) if "model name" in line]
    return {
        "date": datetime.date.today().isoformat(),
        "processor": models[0] if models else platform.processor() or platform.machine(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


class Laps:
    """Process time in ms of the parts of a step, all threads counted."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self.last = time.process_time()

    def lap(self, part: str) -> float:
        """Ms since the last lap."""
        now = time.process_time()
        self.parts[part] = 1e3 * (now - self.last)
        self.last = now
        return self.parts[part]


def interleaved(steps: Mapping[str, Step], rounds: int) -> dict[str, dict[str, float]]:
    """Process time in ms of each step, in turn, each after a call that does not count: no step profits from the caches of another."""
    taken: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            step()
            before = time.process_time_ns()
            step()
            taken[name].append(1e-6 * (time.process_time_ns() - before))
    return {name: statistics(times) for name, times in taken.items()}


def on_gpu(steps: Mapping[str, Step], flush: Step = lambda: None) -> dict[str, dict[str, float]]:
    """Clock time in ms of each step on CUDA, in turn, synchronised before and after. flush: runs before each."""
    taken: dict[str, list[float]] = {name: [] for name in steps}
    for number_ in range(GPU_ROUNDS + GPU_WARM_UPS):
        for name, step in steps.items():
            flush()
            torch.cuda.synchronize()
            before = time.perf_counter_ns()
            step()
            torch.cuda.synchronize()
            if number_ >= GPU_WARM_UPS:
                taken[name].append(1e-6 * (time.perf_counter_ns() - before))
    return {name: statistics(times) for name, times in taken.items()}


def statistics(times: Sequence[float]) -> dict[str, float]:
    low, median, high = np.quantile(times, [0.05, 0.5, 0.95]).tolist()
    return {"min": min(times), "q05": low, "median": median, "q95": high}


def study_options(name: str) -> dict[str, dict[str, Any]]:
    """Options of a benchmark that resumes."""
    out = {"type": Path, "default": Path("runs") / name, "help": "folder of the results so far"}
    return {"out": out, "jobs": {"type": int, "help": "processes, by default one a core"}}


def study(
    function: Callable[..., Values], jobs: Mapping[str, Values], given: argparse.Namespace, modules: Sequence[ModuleType], inputs: str = ""
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Results of a function of an importable module, and reasons of failures, by key of the job; resumes in the folder `given.out`.

    modules, inputs: code and files that decide the results besides the product's code and the jobs' parameters.
    """
    code = digest_of_code() + digest_of(*modules) + inputs
    todo = [Job(key, parameters) for key, parameters in jobs.items()]
    results = run_jobs(function, todo, given.out / "jobs.jsonl", version=code, executor=local(given.jobs), title=function.__name__)
    return {row["key"]: row for row in results.rows}, results.failures
