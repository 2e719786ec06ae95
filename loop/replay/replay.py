"""Recordings read back: run the recorded scenario again and hold it against the recording, or write it as CSV."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import torch

from loop.lighting.record import row, schema
from loop.lighting.result import StepResult
from loop.lighting.simulation import Simulation
from loop.recording.comparison import Comparison, compare
from loop.recording.files import TRAJECTORY, table_of
from loop.recording.manifest import FILE, Manifest
from loop.scenario.model import Scenario, validate
from world.errors import LuxloopError
from world.files import whole
from world.parquet import read_parquet
from world.plugin import refuse_code


@dataclass(frozen=True)
class Recording:
    """A recording as it was read: its manifest, the scenario in it, and the table of its steps."""

    manifest: Manifest
    scenario: Scenario
    table: pa.Table


def load(directory: Path) -> Recording:
    """Read a recording. Raises LuxloopError where it is none, damaged, or written by a newer luxloop."""
    manifest = Manifest.read(directory)
    scenario = validate(manifest.scenario, f"{directory}/manifest.json: scenario")
    return Recording(manifest, scenario, read_parquet(directory / TRAJECTORY))


def replay(
    directory: Path,
    device: torch.device | str | None = None,
    on_step: Callable[[StepResult], None] = lambda result: None,
    *,
    allow_code: bool = False,
) -> Comparison:
    """Run the scenario of a recording again, for as many steps as it has, and compare.

    device: that of the recording if None, or the CPU where there is no such device. on_step: called after every step. allow_code: whether
    modules that the manifest names may run.
    Raises LuxloopError where the recording is damaged or an input file is missing.
    """
    recording = load(directory)
    manifest, scenario, steps = recording.manifest, recording.scenario, recording.table.num_rows
    if steps == 0:
        raise LuxloopError(f"{directory / TRAJECTORY}: holds no step; record the run again")
    if not allow_code:
        refuse_code(scenario, str(directory / FILE))
    simulation = Simulation.prepare(scenario, device or manifest.device_here)
    columns = schema(simulation)
    recorded = columns_of(recording.table, columns, directory / TRAJECTORY)
    notes = manifest.changes(Manifest.of(scenario, simulation.renderer, simulation.device))
    rows = []
    for result in itertools.islice(simulation.run(), steps):
        rows.append(row(result))
        on_step(result)
    held = {name: symbol.function.features for name, symbol in simulation.controlled.items()}
    return Comparison(steps, compare(recorded, table_of(rows, columns), held), tuple(notes))


def columns_of(table: pa.Table, columns: pa.Schema, file: Path) -> pa.Table:
    """The columns of a recording and no others. Raises LuxloopError where one is missing or not of its type."""
    if missing := [name for name in columns.names if name not in table.column_names]:
        raise LuxloopError(f"{file}: the column {missing[0]!r} is missing; record the run again")
    try:
        return table.select(columns.names).cast(columns)
    except (pa.ArrowException, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise LuxloopError(f"{file}: a column is not of its type ({reason}); record the run again") from error


def to_csv(directory: Path, file: Path) -> None:
    """Write a recording's steps as CSV, whole or not at all; missing values are empty fields. Raises LuxloopError where it cannot."""
    table = load(directory).table
    with whole(file) as part:
        pyarrow.csv.write_csv(table, part)
