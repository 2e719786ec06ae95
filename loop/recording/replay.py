"""Recordings read back: run the recorded scenario again and hold it against the recording, or write it as CSV."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import torch

from loop.recording.comparison import Difference, compare, tolerances
from loop.recording.manifest import FILE, Manifest
from loop.recording.recorder import COLUMNS, LATER, SCHEMA, TRAJECTORY, row, table_of
from loop.scenario.model import Scenario, validate
from loop.symbol.simulation import Simulation, StepResult
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


@dataclass(frozen=True)
class Comparison:
    """How a replay differs from its recording. notes: what was different from the start, a sentence each."""

    steps: int
    differences: tuple[Difference, ...]
    notes: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """Whether nothing is out of tolerance."""
        return not self.differences


def load(directory: Path) -> Recording:
    """Read a recording. Raises LuxloopError where it is none, damaged, or written by a newer luxloop."""
    manifest = Manifest.read(directory)
    scenario = validate(manifest.scenario, f"{directory}/manifest.json: scenario")
    return Recording(manifest, scenario, read_table(directory / TRAJECTORY))


def read_table(file: Path) -> pa.Table:
    """Read a trajectory, with the columns of a recording, of an older version too, and no others. Raises LuxloopError if it is damaged."""
    table = read_parquet(file)
    names = [name for name in COLUMNS if name in table.column_names or name not in LATER]
    missing = [name for name in names if name not in table.column_names]
    if missing:
        raise LuxloopError(f"{file}: the column {missing[0]!r} is missing; record the run again")
    try:
        return table.select(names).cast(pa.schema([SCHEMA.field(name) for name in names]))
    except (pa.ArrowException, ValueError) as error:
        raise LuxloopError(f"{file}: a column is not of its type ({_first_line(error)}); record the run again") from error


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
    notes = manifest.changes(Manifest.of(scenario, simulation.renderer, simulation.device))
    rows = []
    for result in itertools.islice(simulation.run(), steps):
        rows.append(row(result))
        on_step(result)
    differences = compare(recording.table, table_of(rows), tolerances(scenario.features))
    return Comparison(steps, differences, tuple(notes))


def to_csv(directory: Path, file: Path) -> None:
    """Write a recording's steps as CSV, whole or not at all; missing values are empty fields. Raises LuxloopError where it cannot."""
    lighting = "lighting" in Manifest.read(directory).scenario
    table = read_parquet(directory / TRAJECTORY) if lighting else load(directory).table
    with whole(file) as part:
        pyarrow.csv.write_csv(table, part)


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0].rstrip(".")
