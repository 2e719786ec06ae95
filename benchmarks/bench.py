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
from statistics import median
from types import ModuleType
from typing import Any, NamedTuple

import torch

from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.report.terminal import markdown_table, number
from luxloop.loop.studies.jobs import Job, Values, digest_of, local
from luxloop.loop.studies.jobs import run as run_jobs

OMP, MESA, BLAS = THREADS = ("OMP_NUM_THREADS", "LP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "numpy", "scipy")
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
    threads: Sequence[str] = THREADS,
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
    where = machine()
    print(", ".join(f"{key} {value}" for key, value in where.items()))
    found = measure(given)
    if goals := found.get("goals"):
        words = {True: "reached", False: "**missed**", None: ""}
        rows = {
            each.what: {
                "measured": "not measured" if each.value is None else f"{each.value:.3g}" + (f" ({each.where})" if each.where else ""),
                "limit": f"{'≥' if each.least else '≤'} {each.limit:g}",
                "": words[each.passed],
            }
            for each in goals
        }
        show("Goals", rows)
        found["goals"] = [each._asdict() | {"passed": each.passed} for each in goals]
    if given.json:
        given.json.write_text(json.dumps({"machine": where, **found}, indent=1) + "\n", "utf-8")
    if failures := found.get("failures"):
        sys.exit("\n".join(f"failed: {key}: {reason}" for key, reason in failures.items()))


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


def machine() -> dict[str, str]:
    """Date, hardware and versions of a measurement."""
    info = Path("/proc/cpuinfo")
    models = [line.partition(": ")[2] for line in (info.read_text().splitlines() if info.exists() else ()) if "model name" in line]
    return {
        "date": datetime.date.today().isoformat(),
        "processor": models[0] if models else platform.processor() or platform.machine(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }


class Laps:
    """Process time in ms of the parts of a step, all threads counted."""

    def __init__(self) -> None:
        self.parts = {}
        self.last = time.process_time()

    def lap(self, part: str) -> float:
        """Ms since the last lap."""
        now = time.process_time()
        self.parts[part] = 1e3 * (now - self.last)
        self.last = now
        return self.parts[part]


def medians(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The median over the rows of each of their values."""
    return {key: median(row[key] for row in rows) for key in rows[0]}


def interleaved(steps: Mapping[str, Step], rounds: int) -> dict[str, float]:
    """Median process time in ms of each step, in turn, each after a call that does not count, so that caches are its own."""
    rows = []
    for _ in range(rounds):
        laps = Laps()
        for name, step in steps.items():
            step()
            laps.lap("warm-up")
            step()
            laps.lap(name)
        rows.append(laps.parts)
    return {name: ms for name, ms in medians(rows).items() if name != "warm-up"}


def on_gpu(steps: Mapping[str, Step], flush: Step = lambda: None) -> dict[str, float]:
    """Median clock time in ms of each step as a CUDA graph, in turn, synchronised before and after. flush: runs before each."""
    graphs = {name: captured(step) for name, step in steps.items()}
    taken = {name: [] for name in steps}
    for _ in range(GPU_ROUNDS + GPU_WARM_UPS):
        for name, graph in graphs.items():
            flush()
            torch.cuda.synchronize()
            before = time.perf_counter()
            graph.replay()
            torch.cuda.synchronize()
            taken[name].append(1e3 * (time.perf_counter() - before))
    return {name: median(times[GPU_WARM_UPS:]) for name, times in taken.items()}


def captured(step: Step) -> torch.cuda.CUDAGraph:
    """A step as a CUDA graph: one launch each time, reading and writing the same tensors."""
    side, graph = torch.cuda.Stream(), torch.cuda.CUDAGraph()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(3):  # libraries make their workspaces in the first calls, which must not be captured
            step()
    torch.cuda.current_stream().wait_stream(side)
    with torch.cuda.graph(graph):
        step()
    return graph


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
