"""`luxloop evaluate`: compare MapReduce control with the joint optimum of all pixels, and show the effect of its parameters (T 8.4,
8.5).
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.controllers.pixels.mrpc_tuning import OPTIONS, THESIS
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.studies.evaluation import jobs
from luxloop.loop.studies.jobs.executors import ALL_CORES, Executor
from luxloop.loop.studies.jobs.runner import Job, Results, digest_of, run
from luxloop.world.files import output_folder
from luxloop.world.lamps.patterns import QUICK, RECTANGLES, Rectangle

LAMPS = ("hd84", "ssl-hd-lores")
JOBS, SETPOINTS, TABLES, SENSITIVITY = "jobs.jsonl", "setpoints.parquet", "tables.parquet", "sensitivity.parquet"
CONTROLS = ("mrpc", "options", "corrected", "ours", "median", "default")  # controls whose errors are computed beside the joint optimum's
Row = dict[str, Any]

# Rows of T tables 8.2 and 8.3: name, a_m (None: no mapping), shape, what is tuned.
ROWS: dict[str, tuple[float | None, str, list[str]]] = {
    "reference": (None, "rectangle", []),
    "exclusion": (None, "rectangle", ["a_x"]),
    "exclusion, mapping": (1.0, "rectangle", ["a_m", "a_x"]),
    "exclusion, mapping, free shape": (1.0, "arbitrary", ["a_m", "a_x"]),
    "exclusion, mapping, free shape, reduction": (1.0, "arbitrary", ["a_m", "a_x", "a_r"]),
}
FIXED_A_M = {"hd84": 1.0, "ssl-hd-lores": 1.015}  # of T figures 8.15 and 8.19


@dataclass(frozen=True)
class Evaluation:
    """Rows of the three parts of an evaluation, and reasons of failed jobs by key."""

    setpoints: list[Row]
    tables: list[Row]
    sensitivity: list[Row]
    failures: dict[str, str]

    @property
    def lamps(self) -> list[str]:
        return [name for name in LAMPS if any(row["name"] == name for row in self.setpoints)]

    def of(self, name: str) -> "Evaluation":
        """The evaluation of one lamp."""
        setpoints, tables, sensitivity = (
            [row for row in rows if row["name"] == name] for rows in (self.setpoints, self.tables, self.sensitivity)
        )
        return Evaluation(setpoints, tables, sensitivity, self.failures)


def evaluate(
    out: Path,
    lamps: Sequence[str] = LAMPS,
    *,
    quick: bool = False,
    executor: Executor = ALL_CORES,
    setpoints: Sequence[Rectangle] | None = None,
    grid: int | None = None,
) -> Evaluation:
    """Compute the results that `out` does not hold yet, and write three Parquet files into it.

    quick: 45 instead of 1,215 rectangles, evenly spread over all five degrees of freedom, and coarser sensitivities. executor: by default a
    process per core. setpoints, grid: other rectangles, and another number of steps per parameter. Raises what
    `luxloop.loop.studies.jobs.runner.run` and `luxloop.world.files.output_folder` raise.
    """
    chosen = setpoints or (QUICK if quick else RECTANGLES)
    parts: dict[str, tuple[Callable[..., Row], list[Job]]] = {
        SETPOINTS: (jobs.setpoint, [job for name in lamps for job in _setpoints(name, chosen)]),
        TABLES: (jobs.table_row, [job for name in lamps for job in _tables(name)]),
        SENSITIVITY: (jobs.sensitivity_row, [job for name in lamps for job in _sensitivities(name, grid or (8 if quick else 40))]),
    }
    version = digest_of_code() + digest_of(jobs)
    results = {}
    with output_folder(out):
        for file, (function, wanted) in parts.items():
            results[file] = run(function, wanted, out / JOBS, version=version, executor=executor, title=file.removesuffix(".parquet"))
            if results[file].rows:
                results[file].write(out / file)
            else:
                (out / file).unlink(missing_ok=True)  # it is none of this evaluation's
    return _evaluation(results)


def summary(rows: Sequence[Row]) -> dict[str, float]:
    """Means and medians over the setpoints of one lamp: MAE, ratios to the joint optimum, and tuned parameters."""
    values = {name: np.array([row[f"{name}_mae"] for row in rows]) for name in ("jpo", *CONTROLS)}
    values |= {f"{name}_ratio": values[name] / values["jpo"] for name in CONTROLS}
    values |= {
        name: np.array([row[name] for row in rows])
        for name in [*THESIS, *(f"{kind}_{each}" for kind in ("options", "corrected") for each in OPTIONS)]
    }
    means = {f"{name}_mean": float(each.mean()) for name, each in values.items()}
    medians = {f"{name}_median": float(np.median(each)) for name, each in values.items()}
    return {"setpoints": len(rows), "gap": max(row["jpo_gap"] for row in rows), **means, **medians}


def _evaluation(results: dict[str, Results]) -> Evaluation:
    failures = {key: text for each in results.values() for key, text in each.failures.items()}
    return Evaluation(results[SETPOINTS].rows, results[TABLES].rows, results[SENSITIVITY].rows, failures)


def _setpoints(name: str, rectangles: Sequence[Rectangle]) -> list[Job]:
    return [
        Job(f"{name}, {r.width:g} x {r.height:g} deg at {r.h:g}, {r.v:g}, turned {r.turn:g}", {"name": name, **asdict(r)})
        for r in rectangles
    ]


def _tables(name: str) -> list[Job]:
    return [
        Job(f"{name}, {key}", {"name": name, "a_m": a_m, "a_r": 1.0, "shape": shape, "tuned": tuned})
        for key, (a_m, shape, tuned) in ROWS.items()
    ]


def _sensitivities(name: str, steps: int) -> list[Job]:
    """Rows of constant a_m and a_r: a_m varies for a_r of 0, 1 and 2, then a_r varies for a fixed a_m; each for both shapes."""
    thresholds, potentials, exponents = (np.linspace(0, top, steps + 1).round(6).tolist() for top in (1, 2, 3))
    pairs = [(a_m, a_r) for a_r in (0.0, 1.0, 2.0) for a_m in [None, *potentials]]
    pairs += [(FIXED_A_M.get(name, 1.0), a_r) for a_r in exponents]
    return [
        Job(f"{name}, a_m {a_m}, a_r {a_r:g}, {shape}", {"name": name, "a_m": a_m, "a_r": a_r, "shape": shape, "thresholds": thresholds})
        for a_m, a_r in dict.fromkeys(pairs)
        for shape in ("rectangle", "arbitrary")
    ]
