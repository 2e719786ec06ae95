"""Recordings read back: run the recorded scenario again and hold it against the recording, or write it as CSV."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.csv
import torch
from pydantic import TypeAdapter

from luxloop.controllers.symbol.sensing.flat_model import FeatureParams
from luxloop.loop.recording.comparison import Comparison, compare
from luxloop.loop.recording.editing import apply_edit
from luxloop.loop.recording.manifest import EDITS, MANIFEST, TRAJECTORY, Manifest, table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.scenario.driving import repeat
from luxloop.loop.scenario.edits import Edit
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.arrays import read_parquet
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import content, reading, whole
from luxloop.world.plugin import refuse_code
from luxloop.world.validation import parsed_json


@dataclass(frozen=True)
class Recording:
    """A recording as it was read: its manifest, the scenario in it, the table of its steps, and the edits while it ran."""

    manifest: Manifest
    scenario: Scenario
    table: pa.Table
    edits: tuple[Edit, ...] = ()


EDIT_LIST: Final = TypeAdapter(tuple[Edit, ...])


def load(directory: Path) -> Recording:
    """Read a recording. Raises LuxloopError where it is none, damaged, or written by a newer luxloop."""
    manifest = Manifest.read(directory)
    scenario = validate(manifest.scenario, f"{directory}/manifest.json: scenario")
    return Recording(manifest, scenario, read_parquet(directory / TRAJECTORY), _edits(directory / EDITS))


def _edits(file: Path) -> tuple[Edit, ...]:
    if not file.is_file():
        return ()
    with reading(file, "damaged, not the edits of a run", "record the run again"):
        return EDIT_LIST.validate_python(parsed_json(content(file)))


def refuse_foreign(directory: Path, scenario: Scenario, edits: Iterable[Edit]) -> None:
    """Raises LuxloopError where the scenario of a recording, or an edit of it, names a module of Python."""
    refuse_code(scenario, str(directory / MANIFEST))
    for edit in edits:
        scenario = repeat(scenario, edit)
        if not edit.driven:
            refuse_code(scenario, str(directory / EDITS))


def rerun(recording: Recording, simulation: Simulation) -> Iterator[tuple[Simulation, Evaluation]]:
    """The steps of a recording once more, each with the simulation that made it. simulation: of its scenario.

    Modules that edits name run. Raises LuxloopError where an edit cannot be repeated.
    """
    state, edits, before = simulation.start(), deque(recording.edits), None
    for step in range(recording.table.num_rows):
        reached, by = state, simulation.scenario
        while edits and edits[0].step <= step:
            simulation, state = apply_edit(simulation, reached, repeat(simulation.scenario, edits.popleft()), by)
        with locate(simulation.scenario.source):
            state, result = simulation.step(state)
            before = simulation.evaluate(result, before)
        yield simulation, before


def replay(
    directory: Path,
    device: torch.device | str | None = None,
    on_step: Callable[[Evaluation], None] = lambda result: None,
    *,
    allow_code: bool = False,
) -> Comparison:
    """Run the scenario of a recording again, with its edits, for as many steps as it has, and compare.

    device: that of the recording if None, or the CPU where there is no such device. on_step: called after every step. allow_code: whether
    modules that the manifest or edits name may run.
    Raises LuxloopError where the recording is damaged or an input file is missing.
    """
    recording = load(directory)
    manifest, scenario = recording.manifest, recording.scenario
    if recording.table.num_rows == 0:
        raise LuxloopError(f"{directory / TRAJECTORY}: holds no step; record the run again")
    if not allow_code:
        refuse_foreign(directory, scenario, recording.edits)
    simulation = Simulation.prepare(scenario, device or manifest.device_here)
    columns = schema(simulation)
    columns_of(recording.table, columns, directory / TRAJECTORY)
    notes = manifest.changes(Manifest.of(scenario, simulation.renderer, simulation.device))
    held = dict[str, FeatureParams]()
    rows = []
    for made_by, result in rerun(recording, simulation):
        held |= {name: symbol.function.features for name, symbol in made_by.controlled.items()}
        columns = pa.unify_schemas([columns, schema(made_by)])
        known = set(columns.names)  # so far: columns that an edit brings begin with it
        rows.append({name: value for name, value in row(result).items() if name in known})
        on_step(result)
    recorded = columns_of(recording.table, columns, directory / TRAJECTORY)
    return Comparison(len(rows), compare(recorded, table_of(rows, columns), held), tuple(notes))


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
