"""Recordings of lighting functions read back: run the recorded scenario again and hold it against the recording."""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa

from loop.lighting.record import row, schema
from loop.lighting.result import LightingResult
from loop.lighting.simulation import LightingSimulation
from loop.recording.comparison import Difference
from loop.recording.manifest import FILE, Manifest
from loop.recording.recorder import TRAJECTORY, table_of
from loop.recording.replay import Comparison
from loop.scenario.model import LightingScenario, validate_any
from world.errors import LuxloopError
from world.parquet import read_parquet
from world.plugin import refuse_code

TOLERANCE = 2e-3  # of a column's largest value: a pixel at the border of a shadow moves a mean of hundreds of pixels by so much


def replay(directory: Path, on_step: Callable[[LightingResult], None] = lambda result: None, *, allow_code: bool = False) -> Comparison:
    """Run the scenario of a recording again, for as many steps as it has, and compare.

    allow_code: whether modules that the manifest names may run.
    Raises LuxloopError where the recording is damaged or an input file is missing.
    """
    manifest = Manifest.read(directory)
    scenario = validate_any(manifest.scenario, f"{directory}/manifest.json: scenario")
    recorded = read_parquet(directory / TRAJECTORY)
    if not isinstance(scenario, LightingScenario) or recorded.num_rows == 0:
        raise LuxloopError(f"{directory / TRAJECTORY}: holds no step of lighting functions; record the run again")
    if not allow_code:
        refuse_code(scenario, str(directory / FILE))
    simulation = LightingSimulation.prepare(scenario, manifest.device_here)
    columns = schema(simulation)
    if missing := [name for name in columns.names if name not in recorded.column_names]:
        raise LuxloopError(f"{directory / TRAJECTORY}: the column {missing[0]!r} is missing; record the run again")
    notes = manifest.changes(Manifest.of(scenario, simulation.renderer, simulation.device))
    rows = []
    for result in itertools.islice(simulation.run(), recorded.num_rows):
        rows.append(row(result))
        on_step(result)
    return Comparison(recorded.num_rows, compare(recorded, table_of(rows, columns)), tuple(notes))


def compare(recorded: pa.Table, replayed: pa.Table) -> tuple[Difference, ...]:
    """Columns that differ by more than TOLERANCE, timings excepted; darkness and all that is no number must agree exactly."""
    found = []
    for name in (name for name in replayed.column_names if not name.endswith("_ms")):
        a, b = recorded[name].to_pylist(), replayed[name].to_pylist()
        numbers = pa.types.is_floating(replayed[name].type)
        tolerance = TOLERANCE * max((abs(v) for v in a if v is not None), default=0.0) if numbers else 0.0
        apart = np.array([_apart(x, y, numbers) for x, y in zip(a, b, strict=False)])
        outside = np.flatnonzero(apart > tolerance)
        if len(outside):
            first, worst = int(outside[0]), int(apart.argmax())
            found.append(Difference(name, tolerance, first, a[first], b[first], float(apart[worst]), worst))
    return tuple(found)


def _apart(a: object, b: object, numbers: bool) -> float:
    if numbers and isinstance(a, float) and isinstance(b, float):
        return abs(a - b)
    return 0.0 if a == b else float("inf")
