"""The harness of the benchmarks: cases, options, one thread, the machine, steps timed in turn, resumable studies, goals, tables, JSON."""

import datetime
import inspect
import json
import os
import platform
import sys
import time
import tomllib
from argparse import SUPPRESS, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, NoReturn

import pandas as pd
import torch

from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.report.terminal import markdown_table, number
from luxloop.loop.studies.jobs import Job, Values, digest_of, local
from luxloop.loop.studies.jobs import run as run_jobs

OMP, MESA, BLAS = THREADS = ("OMP_NUM_THREADS", "LP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "numpy", "scipy")
GPU_ROUNDS, GPU_WARM_UPS = 500, 10  # as in the thesis
Step = Callable[[], Any]
Measure = Callable[[Namespace], dict[str, Any]]


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

    @property
    def row(self) -> dict[str, str]:
        """Of the table of goals."""
        measured = "not measured" if self.value is None else f"{self.value:.3g}" + (f" ({self.where})" if self.where else "")
        limit = f"{'≥' if self.least else '≤'} {self.limit:g}"
        return {"measured": measured, "limit": limit, "": {True: "reached", False: "**missed**", None: ""}[self.passed]}


def cases(measure: Measure, quick: bool = False, **options: Any) -> Namespace:
    """The cases of a benchmark: the TOML file of its name, its table `quick` over that, and options over both."""
    table = tomllib.loads(Path(inspect.getfile(measure)).with_suffix(".toml").read_text("utf-8"))
    few = table.pop("quick", {})
    return Namespace(**table | (few if quick else {}) | options)


def run(measure: Measure, about: str | None, *options: str, threads: Sequence[str] = THREADS) -> None:
    """A benchmark's program: parses `--json`, `--quick` and the options, measures on one thread, prints goals, writes JSON.

    measure: of the cases; prints its tables and returns what JSON gets, with `goals`, a sequence of Goal, and `failures`, reasons by
    key, where it has them. options: keys of the cases that the command line may change. threads: environment variables that libraries
    read at their start.
    """
    if any(os.environ.get(name) != "1" for name in threads):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **dict.fromkeys(threads, "1")})
    parser = ArgumentParser(description=about, formatter_class=RawDescriptionHelpFormatter, argument_default=SUPPRESS)
    parser.add_argument("--json", type=Path, default=None, help="also write the results here")
    parser.add_argument("--quick", action="store_true", help="a small case")
    for name in options:
        default = vars(cases(measure))[name]
        kind = {"nargs": "*"} if isinstance(default, list) else {"type": type(default)}
        parser.add_argument(f"--{name}", help=f"by default {default}", **kind)
    given, where = cases(measure, **vars(parser.parse_args())), machine()
    torch.set_num_threads(1)
    print(", ".join(f"{key} {value}" for key, value in where.items()))
    found = measure(given)
    if goals := found.get("goals"):
        show("Goals", {each.what: each.row for each in goals})
        found["goals"] = [each._asdict() | {"passed": each.passed} for each in goals]
    if given.json:
        given.json.write_text(json.dumps({"machine": where, **found}, indent=1) + "\n", "utf-8")
    if failures := found.get("failures"):
        _fail(failures)


def _fail(failures: Mapping[str, str]) -> NoReturn:
    sys.exit("\n".join(f"failed: {key}: {reason}" for key, reason in failures.items()) or "nothing was measured")


def show(title: str, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table as Markdown: values by column by row. A mapping in place of a value makes a column of each of its values."""
    table = pd.json_normalize(list(rows.values()), sep=" ")
    cells = ((name, *map(_cell, row)) for name, row in zip(rows, table.to_numpy(object), strict=True))
    print(f"\n{title}\n\n{markdown_table(('', *table), cells)}", flush=True)


def _cell(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_cell, value))
    if isinstance(value, float):
        return number(value, ".3g" if abs(value) < 1000 else ",.0f")
    return "–" if value is None else str(value)


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
    return pd.DataFrame(rows).median().to_dict()


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
    rows = []
    for _ in range(GPU_ROUNDS + GPU_WARM_UPS):
        rows.append({})
        for name, graph in graphs.items():
            flush()
            torch.cuda.synchronize()
            before = time.perf_counter()
            graph.replay()
            torch.cuda.synchronize()
            rows[-1][name] = 1e3 * (time.perf_counter() - before)
    return medians(rows[GPU_WARM_UPS:])


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


def study(
    function: Callable[..., Values], jobs: Mapping[str, Values], given: Namespace, modules: Sequence[ModuleType], inputs: str = ""
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Results of a function of an importable module, and reasons of failures, by key of the job.

    Resumes in the folder `given.out`; takes `given.jobs` processes, 0 for one a core.
    modules, inputs: code and files that decide the results besides the product's code and the jobs' parameters.
    """
    code = digest_of_code() + digest_of(*modules) + inputs
    todo = [Job(key, parameters) for key, parameters in jobs.items()]
    results = run_jobs(
        function, todo, Path(given.out) / "jobs.jsonl", version=code, executor=local(given.jobs or None), title=function.__name__
    )
    if not results.rows:
        _fail(results.failures)
    return {row["key"]: row for row in results.rows}, results.failures
